/* Records what a process does to the files below a folder: each call of libc that changes them, with its data, in the order in which it is made.
   RECORDED is the folder, RECORD the log. A record is a head and two texts; disk.py reads it. Buffered streams become cookies, whose
   writes come through write() below: those of libc itself cannot be caught otherwise. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum { OPEN = 1, WRITE, TRUNCATE, FSYNC, RENAME, LINK, UNLINK, MKDIR, CLOSE, DUP };
#define MOST 4096
static char kept[MOST]; /* descriptors of files below the folder */
static int record = -1;
static char *folder;
#define REAL(result, name, ...) \
  static result (*real)(__VA_ARGS__); \
  if (!real) real = (result(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

__attribute__((constructor)) static void begin(void) {
  folder = getenv("RECORDED");
  if (folder && getenv("RECORD")) {
    int opened = syscall(SYS_openat, AT_FDCWD, getenv("RECORD"), O_WRONLY | O_CREAT | O_APPEND, 0600);
    record = syscall(SYS_fcntl, opened, F_DUPFD_CLOEXEC, MOST);
    if (record < 0) record = syscall(SYS_fcntl, opened, F_DUPFD_CLOEXEC, 900);
    syscall(SYS_close, opened);
  }
}

static int is_kept(int fd) { return record >= 0 && fd >= 0 && fd < MOST && kept[fd]; }

static int is_below(const char *path, char *whole) {
  if (record < 0 || !path) return 0;
  if (!strncmp(path, "/dev/fd/", 8)) { /* another descriptor of a file that is open */
    char own[64];
    snprintf(own, sizeof own, "/proc/self/fd/%s", path + 8);
    ssize_t n = readlink(own, whole, PATH_MAX - 1);
    whole[n < 0 ? 0 : n] = 0;
  } else if (path[0] == '/') snprintf(whole, PATH_MAX, "%s", path);
  else {
    char here[PATH_MAX];
    if (!getcwd(here, sizeof here)) return 0;
    snprintf(whole, PATH_MAX, "%s/%s", here, path);
  }
  size_t n = strlen(folder);
  return !strncmp(whole, folder, n) && (!whole[n] || whole[n] == '/');
}

static void tell(int what, int fd, int64_t offset, int64_t value, const char *path, const void *data, size_t n) {
  struct { int32_t what, pid, parent, fd; int64_t offset, value, n_path, n_data; } head = {what, getpid(), getppid(), fd, offset, value, path ? strlen(path) : 0, n};
  struct iovec parts[3] = {{&head, sizeof head}, {(void *)path, head.n_path}, {(void *)data, n}};
  syscall(SYS_writev, record, parts, 3);
}

static int opened(const char *path, int flags, int existed, int fd) {
  char whole[PATH_MAX];
  if (fd >= 0 && fd < MOST) {
    kept[fd] = is_below(path, whole);
    if (kept[fd]) tell(OPEN, fd, existed, flags, whole, NULL, 0);
  }
  return fd;
}

static int open_any(const char *path, int flags, mode_t mode) {
  int existed = faccessat(AT_FDCWD, path, F_OK, 0) == 0;
  return opened(path, flags, existed, syscall(SYS_openat, AT_FDCWD, path, flags, mode));
}
#define MODE(last) va_list rest; va_start(rest, last); mode_t mode = (flags & O_CREAT) ? va_arg(rest, mode_t) : 0; va_end(rest)
int open(const char *path, int flags, ...) { MODE(flags); return open_any(path, flags, mode); }
int open64(const char *path, int flags, ...) { MODE(flags); return open_any(path, flags, mode); }
int creat(const char *path, mode_t mode) { return open_any(path, O_CREAT | O_WRONLY | O_TRUNC, mode); }
int creat64(const char *path, mode_t mode) { return open_any(path, O_CREAT | O_WRONLY | O_TRUNC, mode); }
static int open_at(int place, const char *path, int flags, mode_t mode) {
  return place == AT_FDCWD || path[0] == '/' ? open_any(path, flags, mode) : (int)syscall(SYS_openat, place, path, flags, mode);
}
int openat(int place, const char *path, int flags, ...) { MODE(flags); return open_at(place, path, flags, mode); }
int openat64(int place, const char *path, int flags, ...) { MODE(flags); return open_at(place, path, flags, mode); }

int close(int fd) {
  if (is_kept(fd)) { tell(CLOSE, fd, 0, 0, NULL, NULL, 0); kept[fd] = 0; }
  return syscall(SYS_close, fd);
}
static int copied(int fd, int copy) {
  if (copy >= 0 && copy < MOST && copy != fd) {
    kept[copy] = is_kept(fd);
    if (kept[copy]) tell(DUP, fd, 0, copy, NULL, NULL, 0);
  }
  return copy;
}
int dup(int fd) { return copied(fd, syscall(SYS_dup, fd)); }
int dup2(int fd, int copy) { REAL(int, "dup2", int, int); return copied(fd, real(fd, copy)); }
int dup3(int fd, int copy, int flags) { return copied(fd, syscall(SYS_dup3, fd, copy, flags)); }
int fcntl(int fd, int command, ...) {
  va_list rest; va_start(rest, command); long value = va_arg(rest, long); va_end(rest);
  REAL(int, "fcntl64", int, int, ...);
  int result = real(fd, command, value);
  return command == F_DUPFD || command == F_DUPFD_CLOEXEC ? copied(fd, result) : result;
}
int fcntl64(int fd, int command, ...) {
  va_list rest; va_start(rest, command); long value = va_arg(rest, long); va_end(rest);
  return fcntl(fd, command, value);
}

static ssize_t written(int fd, off_t at, const void *data, ssize_t n) {
  if (n > 0) tell(WRITE, fd, at, n, NULL, data, n);
  return n;
}
static off_t place_of(int fd) {
  struct stat now;
  if (syscall(SYS_fcntl, fd, F_GETFL) & O_APPEND) return fstat(fd, &now) ? 0 : now.st_size;
  return lseek(fd, 0, SEEK_CUR);
}
ssize_t write(int fd, const void *data, size_t n) {
  if (!is_kept(fd)) return syscall(SYS_write, fd, data, n);
  off_t at = place_of(fd);
  return written(fd, at, data, syscall(SYS_write, fd, data, n));
}
ssize_t pwrite(int fd, const void *data, size_t n, off_t at) {
  ssize_t done = syscall(SYS_pwrite64, fd, data, n, at);
  return is_kept(fd) ? written(fd, at, data, done) : done;
}
ssize_t pwrite64(int fd, const void *data, size_t n, off_t at) { return pwrite(fd, data, n, at); }
ssize_t writev(int fd, const struct iovec *parts, int n) {
  if (!is_kept(fd)) return syscall(SYS_writev, fd, parts, n);
  ssize_t all = 0;
  for (int k = 0; k < n; k++) {
    ssize_t done = write(fd, parts[k].iov_base, parts[k].iov_len);
    if (done < 0) return all ? all : done;
    all += done;
    if ((size_t)done < parts[k].iov_len) break;
  }
  return all;
}
int ftruncate(int fd, off_t size) {
  int result = syscall(SYS_ftruncate, fd, size);
  if (!result && is_kept(fd)) tell(TRUNCATE, fd, size, 0, NULL, NULL, 0);
  return result;
}
int ftruncate64(int fd, off_t size) { return ftruncate(fd, size); }
int truncate(const char *path, off_t size) {
  int fd = open(path, O_WRONLY), result = fd < 0 ? -1 : ftruncate(fd, size);
  if (fd >= 0) close(fd);
  return result;
}
int truncate64(const char *path, off_t size) { return truncate(path, size); }
int fsync(int fd) { int r = syscall(SYS_fsync, fd); if (!r && is_kept(fd)) tell(FSYNC, fd, 0, 0, NULL, NULL, 0); return r; }
int fdatasync(int fd) { return fsync(fd); }

static int named(int what, const char *one, const char *other, int result) {
  char first[PATH_MAX], second[PATH_MAX] = "";
  if (!result && is_below(one, first)) {
    if (other) is_below(other, second);
    tell(what, -1, 0, 0, first, second, strlen(second));
  }
  return result;
}
int rename(const char *a, const char *b) { return named(RENAME, a, b, syscall(SYS_renameat2, AT_FDCWD, a, AT_FDCWD, b, 0)); }
int renameat(int x, const char *a, int y, const char *b) { return named(RENAME, a, b, syscall(SYS_renameat2, x, a, y, b, 0)); }
int link(const char *a, const char *b) { return named(LINK, a, b, syscall(SYS_linkat, AT_FDCWD, a, AT_FDCWD, b, 0)); }
int linkat(int x, const char *a, int y, const char *b, int f) { return named(LINK, a, b, syscall(SYS_linkat, x, a, y, b, f)); }
int unlink(const char *a) { return named(UNLINK, a, NULL, syscall(SYS_unlinkat, AT_FDCWD, a, 0)); }
int unlinkat(int x, const char *a, int f) { return named(UNLINK, a, NULL, syscall(SYS_unlinkat, x, a, f)); }
int mkdir(const char *a, mode_t mode) { return named(MKDIR, a, NULL, syscall(SYS_mkdirat, AT_FDCWD, a, mode)); }

static ssize_t stream_read(void *fd, char *data, size_t n) { return read((int)(intptr_t)fd, data, n); }
static ssize_t stream_write(void *fd, const char *data, size_t n) { ssize_t done = write((int)(intptr_t)fd, data, n); return done < 0 ? 0 : done; }
static int stream_seek(void *fd, off64_t *at, int whence) { off_t now = lseek((int)(intptr_t)fd, *at, whence); if (now < 0) return -1; *at = now; return 0; }
static int stream_close(void *fd) { return close((int)(intptr_t)fd); }
static FILE *stream_of(int fd, const char *mode) {
  return fopencookie((void *)(intptr_t)fd, mode, (cookie_io_functions_t){stream_read, stream_write, stream_seek, stream_close});
}
FILE *fdopen(int fd, const char *mode) {
  REAL(FILE *, "fdopen", int, const char *);
  return is_kept(fd) ? stream_of(fd, mode) : real(fd, mode);
}
FILE *fopen(const char *path, const char *mode) {
  REAL(FILE *, "fopen", const char *, const char *);
  char whole[PATH_MAX];
  if (mode[0] == 'r' && !strchr(mode, '+')) return real(path, mode);
  if (!is_below(path, whole)) return real(path, mode);
  int flags = (strchr(mode, '+') ? O_RDWR : O_WRONLY) | (mode[0] == 'r' ? 0 : O_CREAT) | (mode[0] == 'w' ? O_TRUNC : mode[0] == 'a' ? O_APPEND : 0);
  int fd = open_any(path, flags, 0666);
  return fd < 0 ? NULL : stream_of(fd, mode);
}
FILE *fopen64(const char *path, const char *mode) { return fopen(path, mode); }
