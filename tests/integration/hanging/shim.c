/* A disk or file server that does not answer: calls of one kind whose path contains HANG_PATH do not return as long as the
   file HANG_WHILE is there. HANG_CALL is opendir, stat or open. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
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
