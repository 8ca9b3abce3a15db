/* A disk or file server that does not answer: calls of one kind whose path contains HANG_PATH do not return as long as the
   file HANG_WHILE is there. HANG_CALL is opendir, stat, open, or write, which includes syncs and excludes the log. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

static void hang(const char *call, const char *path)
{
    const char *wanted = getenv("HANG_CALL"), *place = getenv("HANG_PATH"), *lasts = getenv("HANG_WHILE");
    if (!wanted || !place || !lasts || !path || strcmp(wanted, call) || !strstr(path, place)) return;
    while (syscall(SYS_faccessat, AT_FDCWD, lasts, F_OK) == 0) usleep(20000);
}

static void *next(const char *name) { return dlsym(RTLD_NEXT, name); }

DIR *opendir(const char *path)
{
    hang("opendir", path);
    return ((DIR *(*)(const char *))next("opendir"))(path);
}

int statx(int folder, const char *path, int flags, unsigned mask, struct statx *found)
{
    hang("stat", path);
    return ((int (*)(int, const char *, int, unsigned, struct statx *))next("statx"))(folder, path, flags, mask, found);
}

static int mode_of(int flags, va_list more) { return flags & (O_CREAT | O_TMPFILE) ? va_arg(more, int) : 0; }

int open64(const char *path, int flags, ...)
{
    va_list more;
    va_start(more, flags);
    int mode = mode_of(flags, more);
    va_end(more);
    hang("open", path);
    return ((int (*)(const char *, int, ...))next("open64"))(path, flags, mode);
}

int open(const char *path, int flags, ...)
{
    va_list more;
    va_start(more, flags);
    int mode = mode_of(flags, more);
    va_end(more);
    hang("open", path);
    return ((int (*)(const char *, int, ...))next("open"))(path, flags, mode);
}

static void hang_on(int fd)
{
    char link[64], path[4096];
    if (fd <= STDERR_FILENO) return;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length <= 0) return;
    path[length] = 0;
    hang("write", path);
}

ssize_t write(int fd, const void *bytes, size_t count)
{
    hang_on(fd);
    return ((ssize_t (*)(int, const void *, size_t))next("write"))(fd, bytes, count);
}

ssize_t pwrite64(int fd, const void *bytes, size_t count, off64_t at)
{
    hang_on(fd);
    return ((ssize_t (*)(int, const void *, size_t, off64_t))next("pwrite64"))(fd, bytes, count, at);
}

ssize_t pwrite(int fd, const void *bytes, size_t count, off_t at)
{
    hang_on(fd);
    return ((ssize_t (*)(int, const void *, size_t, off_t))next("pwrite"))(fd, bytes, count, at);
}

int fsync(int fd)
{
    hang_on(fd);
    return ((int (*)(int))next("fsync"))(fd);
}

int fdatasync(int fd)
{
    hang_on(fd);
    return ((int (*)(int))next("fdatasync"))(fd);
}
