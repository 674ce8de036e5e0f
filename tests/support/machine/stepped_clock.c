// SPDX-License-Identifier: Apache-2.0
// A system clock that a test can set, for a process that loads this library first (LD_PRELOAD).
//
// The file named by STEPPED_CLOCK holds the seconds, a double, by which the clock differs from that
// of the machine. Waits until a time of this clock last longer when it is set back, as they do in
// the kernel.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SLICE 0.02 // s between two looks at the clock during a wait
#define NOT_STEADY 1e9 // s: times of the steady clock, which counts from the start, are below

static const volatile double *offset;
static int (*real_clock)(clockid_t, struct timespec *);
static int (*real_wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);

__attribute__((constructor)) static void begin(void) {
  static const double none = 0.0;
  offset = &none;
  real_clock = dlsym(RTLD_NEXT, "clock_gettime");
  const char *versions[] = {"GLIBC_2.3.2", "GLIBC_2.17"}; // x86-64, aarch64
  for (int i = 0; i < 2 && !real_wait; i++)
    real_wait = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", versions[i]);
  const char *name = getenv("STEPPED_CLOCK");
  int file = name ? open(name, O_RDONLY | O_CLOEXEC) : -1;
  if (file < 0) return;
  void *shared = mmap(NULL, sizeof *offset, PROT_READ, MAP_SHARED, file, 0);
  close(file);
  if (shared != MAP_FAILED) offset = shared;
}

static double seconds(struct timespec time) { return time.tv_sec + 1e-9 * time.tv_nsec; }

static struct timespec split(double time) {
  struct timespec parts = {(time_t)time, 0};
  parts.tv_nsec = (long)(1e9 * (time - parts.tv_sec));
  return parts;
}

int clock_gettime(clockid_t clock, struct timespec *time) {
  if (!real_clock) begin();
  int status = real_clock(clock, time);
  if (!status && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) time->tv_sec += (time_t)*offset;
  return status;
}

time_t time(time_t *result) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (result) *result = now.tv_sec;
  return now.tv_sec;
}

int gettimeofday(struct timeval *result, void *zone) {
  (void)zone;
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  result->tv_sec = now.tv_sec;
  result->tv_usec = now.tv_nsec / 1000;
  return 0;
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *until) {
  if (!real_wait) begin();
  if (seconds(*until) < NOT_STEADY) return real_wait(condition, mutex, until);
  for (;;) {
    struct timespec now;
    real_clock(CLOCK_REALTIME, &now);
    double end = seconds(*until) - *offset, next = seconds(now) + SLICE;
    struct timespec slice = split(end < next ? end : next);
    int status = real_wait(condition, mutex, &slice);
    if (status != ETIMEDOUT || end <= next) return status;
  }
}
