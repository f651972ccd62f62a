/* SPDX-License-Identifier: Apache-2.0
 *
 * Preloaded into a program (LD_PRELOAD), it kills that one with SIGKILL at the KILL_AT-th of its calls that change files:
 * writes are half done by then, all others not begun. Or the disk is full from the FULL_AT-th on: that write does half of
 * what it should, those after it nothing, and nothing new can be made. Without either it only counts. CALL_COUNT names a
 * file that says at the program's end how many calls there were. calls.c makes every one of them.
 *   cc -shared -fPIC -O2 -o crash_at.so crash_at.c
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
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
  int last; /* the program ends with it */
  int full; /* the disk is */
  int half; /* of its bytes are written */
};

static struct fate next_fate(void) {
  const long call = atomic_fetch_add(&calls, 1) + 1, full = asked("FULL_AT");
  const int last = asked("KILL_AT") == call;
  return (struct fate){last, full > 0 && call >= full, last || call == full};
}

/* Of a call that writes to `fd`. Terminals and pipes are no files. */
static struct fate fate_of(int fd) {
  struct stat s;
  return fstat(fd, &s) == 0 && S_ISREG(s.st_mode) ? next_fate() : (struct fate){0, 0, 0};
}

static int no_room(void) {
  errno = ENOSPC;
  return -1;
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

/* Calls that write n bytes to fd; their arguments have k of them. */
#define WRITES(name, parameters, arguments)                          \
  ssize_t name parameters {                                          \
    const struct fate f = fate_of(fd);                               \
    size_t k = n;                                                    \
    if (!f.last && !f.full) return NEXT(name) arguments;             \
    k = n / 2;                                                       \
    const ssize_t done = f.half && k > 0 ? NEXT(name) arguments : 0; \
    if (f.last) end();                                               \
    return done > 0 ? done : no_room();                              \
  }
WRITES(write, (int fd, const void* bytes, size_t n), (fd, bytes, k))
WRITES(pwrite, (int fd, const void* bytes, size_t n, off_t at), (fd, bytes, k, at))
WRITES(pwrite64, (int fd, const void* bytes, size_t n, off64_t at), (fd, bytes, k, at))
WRITES(sendfile, (int fd, int from, off_t* at, size_t n), (fd, from, at, k))
WRITES(sendfile64, (int fd, int from, off64_t* at, size_t n), (fd, from, at, k))
WRITES(copy_file_range, (int from, off64_t* a, int fd, off64_t* b, size_t n, unsigned flags),
       (from, a, fd, b, k, flags))

ssize_t writev(int fd, const struct iovec* pieces, int count) {
  const struct fate f = fate_of(fd);
  if (!f.last && !f.full) return NEXT(writev)(fd, pieces, count);
  size_t left = 0;
  ssize_t done = 0;
  for (int i = 0; i < count; ++i) left += pieces[i].iov_len;
  left = f.half ? left / 2 : 0;
  for (int i = 0; i < count && left > 0; ++i) {
    const size_t n = pieces[i].iov_len < left ? pieces[i].iov_len : left;
    const ssize_t written = NEXT(write)(fd, pieces[i].iov_base, n);
    if (written <= 0) break;
    done += written, left -= (size_t)written;
  }
  if (f.last) end();
  return done > 0 ? done : no_room();
}

size_t fwrite(const void* bytes, size_t size, size_t n, FILE* file) {
  const struct fate f = fate_of(fileno(file));
  if (!f.last && !f.full) return NEXT(fwrite)(bytes, size, n, file);
  const size_t done = f.half ? NEXT(fwrite)(bytes, size, n / 2, file) : 0;
  if (f.last) {
    fflush(file);
    end();
  }
  errno = ENOSPC;
  return done;
}

/* Calls that take room or make something. */
#define NEEDS_ROOM(name, parameters, arguments)       \
  int name parameters {                               \
    const struct fate f = next_fate();                \
    if (f.last) end();                                \
    return f.full ? no_room() : NEXT(name) arguments; \
  }
NEEDS_ROOM(fsync, (int fd), (fd))
NEEDS_ROOM(fdatasync, (int fd), (fd))
NEEDS_ROOM(fallocate, (int fd, int mode, off_t at, off_t n), (fd, mode, at, n))
NEEDS_ROOM(fallocate64, (int fd, int mode, off64_t at, off64_t n), (fd, mode, at, n))
NEEDS_ROOM(mkdir, (const char* a, mode_t m), (a, m))
NEEDS_ROOM(mkdirat, (int d, const char* a, mode_t m), (d, a, m))
NEEDS_ROOM(link, (const char* a, const char* b), (a, b))
NEEDS_ROOM(linkat, (int d, const char* a, int e, const char* b, int how), (d, a, e, b, how))
NEEDS_ROOM(symlink, (const char* a, const char* b), (a, b))
NEEDS_ROOM(symlinkat, (const char* a, int d, const char* b), (a, d, b))

/* These return the number of the error. */
#define TAKES_ROOM(name, offset)                    \
  int name(int fd, offset at, offset n) {           \
    const struct fate f = next_fate();              \
    if (f.last) end();                              \
    return f.full ? ENOSPC : NEXT(name)(fd, at, n); \
  }
TAKES_ROOM(posix_fallocate, off_t)
TAKES_ROOM(posix_fallocate64, off64_t)

/* These need no room. */
#define BEFORE(name, parameters, arguments) \
  int name parameters {                     \
    if (next_fate().last) end();            \
    return NEXT(name) arguments;            \
  }
BEFORE(rename, (const char* a, const char* b), (a, b))
BEFORE(renameat, (int d, const char* a, int e, const char* b), (d, a, e, b))
BEFORE(renameat2, (int d, const char* a, int e, const char* b, unsigned f), (d, a, e, b, f))
BEFORE(unlink, (const char* a), (a))
BEFORE(unlinkat, (int d, const char* a, int f), (d, a, f))
BEFORE(rmdir, (const char* a), (a))
BEFORE(remove, (const char* a), (a))
BEFORE(truncate, (const char* a, off_t n), (a, n))
BEFORE(truncate64, (const char* a, off64_t n), (a, n))
BEFORE(ftruncate, (int fd, off_t n), (fd, n))
BEFORE(ftruncate64, (int fd, off64_t n), (fd, n))

/* What comes before a file is opened: it may be made, for which there has to be room, or emptied.
   returns  whether there is room */
static int may_open(int folder, const char* path, int flags) {
  struct stat s;
  const int there = fstatat(folder, path, &s, 0) == 0;
  if (there ? !(flags & O_TRUNC) || !S_ISREG(s.st_mode) || s.st_size == 0 : !(flags & O_CREAT))
    return 1;
  const struct fate f = next_fate();
  if (f.last) end();
  return there || !f.full;
}

#define OPENS(name, parameters, folder, arguments)                                \
  int name parameters {                                                           \
    va_list more;                                                                 \
    va_start(more, flags);                                                        \
    const mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0; \
    va_end(more);                                                                 \
    return may_open(folder, path, flags) ? NEXT(name) arguments : no_room();      \
  }
OPENS(open, (const char* path, int flags, ...), AT_FDCWD, (path, flags, mode))
OPENS(open64, (const char* path, int flags, ...), AT_FDCWD, (path, flags, mode))
OPENS(openat, (int folder, const char* path, int flags, ...), folder, (folder, path, flags, mode))
OPENS(openat64, (int folder, const char* path, int flags, ...), folder, (folder, path, flags, mode))

static int may_fopen(const char* path, const char* mode) {
  const int flags = *mode == 'w' ? O_CREAT | O_TRUNC : *mode == 'a' ? O_CREAT : 0;
  return may_open(AT_FDCWD, path, flags) || no_room() == 0;
}

FILE* fopen(const char* path, const char* mode) {
  return may_fopen(path, mode) ? NEXT(fopen)(path, mode) : NULL;
}
FILE* fopen64(const char* path, const char* mode) {
  return may_fopen(path, mode) ? NEXT(fopen64)(path, mode) : NULL;
}

__attribute__((destructor)) static void tell(void) {
  const char* where = getenv("CALL_COUNT");
  const long n = atomic_load(&calls);
  FILE* file = where ? NEXT(fopen)(where, "w") : NULL;
  if (!file) return;
  fprintf(file, "%ld\n", n);
  fclose(file);
}
