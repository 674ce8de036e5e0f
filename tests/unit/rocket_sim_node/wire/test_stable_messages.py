# SPDX-License-Identifier: Apache-2.0
"""Definitions of messages, services and actions: they do not change before version 2.0."""
from __future__ import annotations

import json
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

SOURCE = Path(__file__).parents[4] / 'rocket_msgs'
HASHES = {
    'msg/Action':
        'RIHS01_fc17d0b647d5d22386b0f3937802467e6d05a1cfff8e9fb112540e3b9d968e74',
    'msg/Episodes':
        'RIHS01_478db54ea988a62ea57ea20571b08d969df35fbe3558b718eae3662c93f1e560',
    'msg/FlightFigures':
        'RIHS01_befa137545f9f4077329c42837d75f767a80a1de015299e6e4263cef0c2d7935',
    'msg/Observation':
        'RIHS01_7e262c68f83d07c8ce6a71e6bd1f388ec4264a7336f6380e611661c4a15e94c5',
    'msg/Reward':
        'RIHS01_01fe55c8c7fc27a43ba380d79ba22af0e8ec1c9e544bc2909fc0528692bb5be6',
    'msg/RocketState':
        'RIHS01_f3b74035eb59cb6a2e07b9fdcad6132b198dda80373eaf469f26400cb8e0f557',
    'msg/Setting':
        'RIHS01_795d60c6a99efa50fb6439c12dccb96ce356d3fd11e0474e75765a4758a05be0',
    'msg/TrainingStatus':
        'RIHS01_e78d4de33c8d63c15f5529a4210e8bce24b85f7b43b15b93feac4d30084583f9',
    'msg/World':
        'RIHS01_75985176e804b6c58571ddd18f49979464df11998c3c23c9e89eae0e7a2bf575',
    'srv/Release':
        'RIHS01_d702cc017651e40254fe035af97ccc228b7bfbde7a9053432c1e75ed5b74abee',
    'srv/Reset':
        'RIHS01_816227a207fa15406ee32f7f7564763747b7948791ec54aaaacf801dfe004396',
    'srv/Restore':
        'RIHS01_58459de3d7dc9a2e5d2d9787b30689e61399eebb2f740779803407823986b316',
    'srv/Snapshot':
        'RIHS01_83d4c038ede2c41e300dd3ff97d444e7aea0fe225d2a07d607108b6bd801e22e',
    'action/Evaluate':
        'RIHS01_59cfecab47f21b1da36b5bc8da9ec4279d8e0ee91fcabd3161d69c0dcace2256',
    'action/Land':
        'RIHS01_774cd0009758787109cffbdbd834265f14c5a101c4d2d797caa06874def6fe7b',
    'action/Train':
        'RIHS01_efdcf97209bc0d89d985741b1a04d56cbf38ddfdd6477b272c3c5d7339e4a8ad',
}
"""Hashes of the definitions (REP 2016), as of 1.0. A new definition is a new row; a changed one
needs version 2.0."""


def test_definitions_are_those_of_version_1() -> None:
    share = Path(get_package_share_directory('rocket_msgs'))
    found = {}
    for kind in ('msg', 'srv', 'action'):
        for path in sorted((SOURCE / kind).iterdir()):
            described = json.loads((share / kind / f'{path.stem}.json').read_text())
            name = f'{kind}/{path.stem}'
            found[name] = next(
                one['hash_string'] for one in described['type_hashes']
                if one['type_name'] == f'rocket_msgs/{name}')
    assert found == HASHES
