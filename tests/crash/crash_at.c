/* SPDX-License-Identifier: Apache-2.0
 *
 * Preloaded into a program (LD_PRELOAD), it kills that one with SIGKILL at the KILL_AT-th of its calls that change files:
 * writes are half done by then, all others not begun. Or the disk is full from the FULL_AT-th on: that write does half of
 * what it should, those after it nothing. Without either it only counts. CALL_COUNT names a file that says at the
 * program's end how many calls there were.
 *   cc -shared -fPIC -O2 -o crash_at.so crash_at.c
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

static atomic_long calls;

static long asked(const char* name) {
  const char* at = getenv(name);
  return at ? atol(at) : 0;
}

static void end(void) {
  kill(getpid(), SIGKILL);
  for (;;) pause();
}

/* What becomes of a call. */
struct fate {
  int last;      /* the program ends with it */
  int full;      /* the disk is */
  int half;      /* of its bytes are written */
};

static struct fate next_fate(void) {
  const long call = atomic_fetch_add(&calls, 1) + 1, full = asked("FULL_AT");
  const int last = asked("KILL_AT") == call;
  return (struct fate){last, full > 0 && call >= full, last || call == full};
}

/* Terminals and pipes are no files. */
static int changes_a_file(int fd) {
  struct stat s;
  return fstat(fd, &s) == 0 && S_ISREG(s.st_mode);
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

ssize_t write(int fd, const void* bytes, size_t n) {
  if (!changes_a_file(fd)) return NEXT(write)(fd, bytes, n);
  const struct fate f = next_fate();
  if (!f.last && !f.full) return NEXT(write)(fd, bytes, n);
  const ssize_t done = f.half && n > 1 ? NEXT(write)(fd, bytes, n / 2) : 0;
  if (f.last) end();
  if (done > 0) return done;
  errno = ENOSPC;
  return -1;
}

ssize_t pwrite64(int fd, const void* bytes, size_t n, off64_t at) {
  if (!changes_a_file(fd)) return NEXT(pwrite64)(fd, bytes, n, at);
  const struct fate f = next_fate();
  if (!f.last && !f.full) return NEXT(pwrite64)(fd, bytes, n, at);
  const ssize_t done = f.half && n > 1 ? NEXT(pwrite64)(fd, bytes, n / 2, at) : 0;
  if (f.last) end();
  if (done > 0) return done;
  errno = ENOSPC;
  return -1;
}

size_t fwrite(const void* bytes, size_t size, size_t n, FILE* file) {
  if (!changes_a_file(fileno(file))) return NEXT(fwrite)(bytes, size, n, file);
  const struct fate f = next_fate();
  if (!f.last && !f.full) return NEXT(fwrite)(bytes, size, n, file);
  const size_t done = f.half ? NEXT(fwrite)(bytes, size, n / 2, file) : 0;
  if (f.last) {
    fflush(file);
    end();
  }
  errno = ENOSPC;
  return done;
}

int fsync(int fd) {
  const struct fate f = next_fate();
  if (f.last) end();
  if (!f.full) return NEXT(fsync)(fd);
  errno = ENOSPC;
  return -1;
}

/* These need no room. */
#define BEFORE(name, parameters, arguments) \
  int name parameters {                     \
    if (next_fate().last) end();            \
    return NEXT(name) arguments;            \
  }
BEFORE(rename, (const char* a, const char* b), (a, b))
BEFORE(renameat2, (int d, const char* a, int e, const char* b, unsigned f), (d, a, e, b, f))
BEFORE(unlink, (const char* a), (a))
BEFORE(unlinkat, (int d, const char* a, int f), (d, a, f))
BEFORE(rmdir, (const char* a), (a))
BEFORE(remove, (const char* a), (a))
BEFORE(mkdir, (const char* a, mode_t m), (a, m))
BEFORE(ftruncate64, (int fd, off64_t n), (fd, n))

__attribute__((destructor)) static void tell(void) {
  const char* where = getenv("CALL_COUNT");
  const long n = atomic_load(&calls);
  FILE* file = where ? fopen(where, "w") : NULL;
  if (!file) return;
  fprintf(file, "%ld\n", n);
  fclose(file);
}
