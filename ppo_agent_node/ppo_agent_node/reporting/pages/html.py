# SPDX-License-Identifier: Apache-2.0
"""HTML building blocks of self-contained pages: no network, light and dark, mobile, print."""
from __future__ import annotations

import base64
import html
from collections.abc import Iterable
from collections.abc import Sequence
from pathlib import Path

_CSS = """
:root { color-scheme: light dark; --ink: #1d2430; --soft: #5b6472; --page: #fff; --card: #f4f6f8;
  --line: #d9dee5; --accent: #0072b2; --mark: #fff3cd; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ee; --soft: #a3adba; --page: #14181d;
  --card: #1e242b; --line: #343c46; --accent: #56b4e9; --mark: #4a3f14; } }
@media print { :root { --ink: #000; --soft: #333; --page: #fff; --card: #fff; --line: #bbb;
  --accent: #000; --mark: #eee; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem; max-width: 66rem; background: var(--page);
  color: var(--ink); font: 16px/1.5 system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .2rem 0; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid var(--line);
  padding-bottom: .2rem; }
h3 { font-size: 1.02rem; margin: 1.4rem 0 .3rem; }
p.lead, figcaption, .note, .soft { color: var(--soft); }
p.lead { margin: 0 0 1rem; }
a { color: var(--accent); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(8.6rem, 1fr)); gap: .7rem; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: .5rem;
  padding: .6rem .8rem; }
.card b { display: block; font-size: 1.2rem; line-height: 1.3; overflow-wrap: anywhere; }
.card span { font-size: .85rem; color: var(--soft); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th, td { text-align: left; padding: .28rem .7rem .28rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; }
th { color: var(--soft); font-weight: 600; }
td { font-variant-numeric: tabular-nums; overflow-wrap: break-word; }
td:first-child { min-width: 7.5rem; overflow-wrap: anywhere; }
table.numbers td:not(:first-child) { white-space: nowrap; }
tr.changed td { background: var(--mark); }
code { font: .92em ui-monospace, 'DejaVu Sans Mono', Menlo, monospace; overflow-wrap: anywhere; }
figure { margin: 1rem 0 1.6rem; break-inside: avoid; }
figure img { display: block; width: 100%; height: auto; background: #fff;
  border: 1px solid var(--line); border-radius: .4rem; }
figcaption { margin-top: .3rem; font-size: .92rem; }
details { margin: .6rem 0; }
summary { cursor: pointer; font-weight: 600; }
input[type=search] { width: 100%; max-width: 24rem; padding: .4rem .6rem; margin: .4rem 0;
  font: inherit; color: inherit; background: var(--card); border: 1px solid var(--line);
  border-radius: .4rem; }
.note { background: var(--card); border-left: 4px solid var(--accent); padding: .5rem .8rem;
  margin: .6rem 0; }
@media print { body { max-width: none; padding: 0; font-size: 10pt; } .screen { display: none; }
  tr, .card { break-inside: avoid; } h2, h3 { break-after: avoid; } }
"""

_SCRIPT = """
const box = document.querySelector('input[type=search]');
if (box) box.addEventListener('input', () => {
  const words = box.value.toLowerCase().split(/\\s+/);
  for (const row of document.querySelectorAll('table.settings tbody tr')) {
    const text = row.textContent.toLowerCase();
    row.hidden = !words.every(word => text.includes(word));
  }
  for (const part of document.querySelectorAll('details.settings')) part.open = true;
});
addEventListener('beforeprint', () => {
  for (const part of document.querySelectorAll('details')) part.open = true;
});
"""

# Nothing is fetched, even if a name in a file contains markup.
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'")


class Markup(str):
    """Text that is already HTML; all other text is escaped."""

    __slots__ = ()


def escaped(text: object) -> Markup:
    """Return a text as HTML that displays it literally."""
    return text if isinstance(text, Markup) else Markup(html.escape(str(text)))


def tag(name: str, *content: object, **attributes: str) -> Markup:
    """Return an element; `class_` stands for `class`."""
    text = ''.join(
        f' {key.rstrip("_")}="{html.escape(value)}"' for key, value in attributes.items())
    return Markup(f'<{name}{text}>{"".join(map(escaped, content))}</{name}>')


def table(
    head: Sequence[object], rows: Iterable[Sequence[object]], class_: str = '',
    marked: Sequence[bool] = (),
) -> Markup:
    """Return a table that scrolls on small screens.

    :param marked: which rows are highlighted; none when empty.
    """
    body = Markup('\n').join(
        tag('tr', *(tag('td', cell) for cell in row),
            **({'class_': 'changed'} if marked and marked[place] else {}))
        for place, row in enumerate(rows))
    top = tag('thead', tag('tr', *(tag('th', cell) for cell in head))) if head else ''
    inner = tag('table', Markup(top), tag('tbody', Markup(body)), class_=class_)
    return tag('div', inner, class_='scroll')


def cards(items: Iterable[tuple[str, str, str]]) -> Markup:
    """Return the headline cards, each from (label, value, details)."""
    return tag('div', *(
        tag('div', tag('span', what), tag('b', value), tag('span', more), class_='card')
        for what, value, more in items), class_='cards')


def figure(path: Path, title: str, caption: str) -> Markup:
    """Return a heading and a picture embedded in the page, with its caption.

    :raises OSError: when it cannot be read.
    """
    data = base64.b64encode(path.read_bytes()).decode()
    image = Markup(
        f'<img src="data:image/png;base64,{data}" alt="{html.escape(f"{title}. {caption}")}">')
    return Markup(tag('h3', title) + tag('figure', image, tag('figcaption', caption)))


def document(title: str, *body: object) -> str:
    """Return the page."""
    inner = '\n'.join(map(escaped, body))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<title>{html.escape(title)}</title>
<style>{_CSS}</style>
</head>
<body>
{inner}
<script>{_SCRIPT}</script>
</body>
</html>
"""
