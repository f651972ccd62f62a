/* SPDX-License-Identifier: Apache-2.0
 *
 * Makes the one call of that name, of those that crash_at.c counts, in a folder that holds `file` with 8 bytes or more
 * and an empty folder `folder`. Without a name it tells all, each with whether it needs room.
 *   calls [NAME]
 * returns  0, or the number of the error
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

/* What a call returned, as 0 or the number of the error. */
static int code(long returned) { return returned < 0 ? errno : 0; }

/* What a write of 8 bytes returned: half of them are those of a disk that is full. */
static int all(long written) { return written < 0 ? errno : written < 8 ? ENOSPC : 0; }

static int stream(FILE* file) { return file ? 0 : errno; }

int main(int count, char** arguments) {
  const int fd = open("file", O_RDWR), other = open("file", O_RDONLY), here = AT_FDCWD;
  struct iovec pieces[] = {{"1234", 4}, {"5678", 4}};
  FILE* file = fdopen(fd, "r+");
  off_t from = 0, to = 8;
#define CALL(name, room, result)             \
  if (count < 2)                             \
    printf("%s %s\n", #name, room);          \
  else if (strcmp(arguments[1], #name) == 0) \
    return result;
  CALL(write, "room", all(write(fd, "12345678", 8)))
  CALL(pwrite, "room", all(pwrite(fd, "12345678", 8, 0)))
  CALL(pwrite64, "room", all(pwrite64(fd, "12345678", 8, 0)))
  CALL(writev, "room", all(writev(fd, pieces, 2)))
  CALL(fwrite, "room", all((long)fwrite("12345678", 1, 8, file)))
  CALL(sendfile, "room", all(sendfile(fd, other, &from, 8)))
  CALL(sendfile64, "room", all(sendfile64(fd, other, &from, 8)))
  CALL(copy_file_range, "room", all(copy_file_range(other, &from, fd, &to, 8, 0)))
  CALL(fsync, "room", code(fsync(fd)))
  CALL(fdatasync, "room", code(fdatasync(fd)))
  CALL(fallocate, "room", code(fallocate(fd, 0, 0, 64)))
  CALL(fallocate64, "room", code(fallocate64(fd, 0, 0, 64)))
  CALL(posix_fallocate, "room", posix_fallocate(fd, 0, 64))
  CALL(posix_fallocate64, "room", posix_fallocate64(fd, 0, 64))
  CALL(mkdir, "room", code(mkdir("new", 0755)))
  CALL(mkdirat, "room", code(mkdirat(here, "new", 0755)))
  CALL(link, "room", code(link("file", "new")))
  CALL(linkat, "room", code(linkat(here, "file", here, "new", 0)))
  CALL(symlink, "room", code(symlink("file", "new")))
  CALL(symlinkat, "room", code(symlinkat("file", here, "new")))
  CALL(open, "room", code(open("new", O_WRONLY | O_CREAT, 0644)))
  CALL(open64, "room", code(open64("new", O_WRONLY | O_CREAT, 0644)))
  CALL(openat, "room", code(openat(here, "new", O_WRONLY | O_CREAT, 0644)))
  CALL(openat64, "room", code(openat64(here, "new", O_WRONLY | O_CREAT, 0644)))
  CALL(fopen, "room", stream(fopen("new", "w")))
  CALL(fopen64, "room", stream(fopen64("new", "w")))
  CALL(emptied, "none", code(open("file", O_WRONLY | O_TRUNC)))
  CALL(rename, "none", code(rename("file", "new")))
  CALL(renameat, "none", code(renameat(here, "file", here, "new")))
  CALL(renameat2, "none", code(renameat2(here, "file", here, "new", 0)))
  CALL(unlink, "none", code(unlink("file")))
  CALL(unlinkat, "none", code(unlinkat(here, "file", 0)))
  CALL(rmdir, "none", code(rmdir("folder")))
  CALL(remove, "none", code(remove("file")))
  CALL(truncate, "none", code(truncate("file", 2)))
  CALL(truncate64, "none", code(truncate64("file", 2)))
  CALL(ftruncate, "none", code(ftruncate(fd, 2)))
  CALL(ftruncate64, "none", code(ftruncate64(fd, 2)))
  return count < 2 ? 0 : EINVAL;
}
