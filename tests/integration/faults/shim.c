/* Makes system calls fail on files whose path contains FAULT_PATH. Loaded before the C library.
 *
 * FAULT_CALL   read, write, sync, truncate, rename or open; pread counts as read and so on
 * FAULT_ERRNO  what fails with; 0: nothing fails, see FAULT_SHORT and FAULT_SLEEP_US
 * FAULT_AFTER  so many bytes of read and write, or calls of the others, pass before the first failure
 * FAULT_TIMES  so many failures, then all is well again; 0: for ever
 * FAULT_EVERY  only every so many-th call fails
 * FAULT_SHORT  a read gives 1 to so many bytes
 * FAULT_SLEEP_US  a read takes so long
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static long passed, failures, calls;

static long setting(const char *name) {
    const char *text = getenv(name);
    return text ? atol(text) : 0;
}

static int is_call(const char *name) {
    const char *wanted = getenv("FAULT_CALL");
    return wanted && strcmp(wanted, name) == 0;
}

static int is_path(const char *path) {
    const char *wanted = getenv("FAULT_PATH");
    return wanted && path && strstr(path, wanted) != NULL;
}

static int is_file(int fd) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0)
        return 0;
    path[length] = 0;
    return is_path(path);
}

/* Bytes of `count` that may pass now, or -1 for a failure with errno set. Calls without bytes count as one. */
static long admitted(long count) {
    long error = setting("FAULT_ERRNO"), times = setting("FAULT_TIMES"), every = setting("FAULT_EVERY");
    long after = setting("FAULT_AFTER");
    if (error == 0)
        return count;
    pthread_mutex_lock(&lock);
    int over = times > 0 && failures >= times;
    int spared = every > 0 && ++calls % every != 0;
    long left = after - passed;
    if (!over && !spared && left <= 0) {
        failures++;
        count = -1;
    } else if (!over && !spared && left < count) {
        count = left;
    }
    if (count > 0)
        passed += count;
    pthread_mutex_unlock(&lock);
    if (count < 0)
        errno = (int)error;
    return count;
}

static size_t shortened(size_t count) {
    static unsigned state = 12345;
    long most = setting("FAULT_SHORT"), sleep_us = setting("FAULT_SLEEP_US");
    if (sleep_us > 0)
        usleep((useconds_t)sleep_us);
    if (most <= 0)
        return count;
    pthread_mutex_lock(&lock);
    state = state * 1103515245u + 12345u;
    size_t some = 1 + (state >> 16) % (unsigned)most;
    pthread_mutex_unlock(&lock);
    return some < count ? some : count;
}

#define NEXT(name) static __typeof__(&name) next; if (!next) next = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

#define READING(fd, count) \
    if (count > 0 && is_call("read") && is_file(fd)) { \
        long some = admitted((long)count); \
        if (some < 0) return -1; \
        count = shortened((size_t)some); \
    }

#define WRITING(fd, count) \
    if (count > 0 && is_call("write") && is_file(fd)) { \
        long some = admitted((long)count); \
        if (some < 0) return -1; \
        count = (size_t)some; \
    }

ssize_t read(int fd, void *buffer, size_t count) {
    NEXT(read);
    READING(fd, count)
    return next(fd, buffer, count);
}

ssize_t pread(int fd, void *buffer, size_t count, off_t at) {
    NEXT(pread);
    READING(fd, count)
    return next(fd, buffer, count, at);
}

ssize_t pread64(int fd, void *buffer, size_t count, off64_t at) {
    NEXT(pread64);
    READING(fd, count)
    return next(fd, buffer, count, at);
}

ssize_t write(int fd, const void *buffer, size_t count) {
    NEXT(write);
    WRITING(fd, count)
    return next(fd, buffer, count);
}

ssize_t pwrite(int fd, const void *buffer, size_t count, off_t at) {
    NEXT(pwrite);
    WRITING(fd, count)
    return next(fd, buffer, count, at);
}

ssize_t pwrite64(int fd, const void *buffer, size_t count, off64_t at) {
    NEXT(pwrite64);
    WRITING(fd, count)
    return next(fd, buffer, count, at);
}

int fsync(int fd) {
    NEXT(fsync);
    if (is_call("sync") && is_file(fd) && admitted(1) < 0) return -1;
    return next(fd);
}

int fdatasync(int fd) {
    NEXT(fdatasync);
    if (is_call("sync") && is_file(fd) && admitted(1) < 0) return -1;
    return next(fd);
}

int ftruncate(int fd, off_t length) {
    NEXT(ftruncate);
    if (is_call("truncate") && is_file(fd) && admitted(1) < 0) return -1;
    return next(fd, length);
}

int ftruncate64(int fd, off64_t length) {
    NEXT(ftruncate64);
    if (is_call("truncate") && is_file(fd) && admitted(1) < 0) return -1;
    return next(fd, length);
}

int rename(const char *from, const char *to) {
    NEXT(rename);
    if (is_call("rename") && (is_path(from) || is_path(to)) && admitted(1) < 0) return -1;
    return next(from, to);
}

static mode_t mode_of(int flags, va_list arguments) {
    return (flags & O_CREAT) || (flags & O_TMPFILE) == O_TMPFILE ? va_arg(arguments, mode_t) : 0;
}

int open(const char *path, int flags, ...) {
    NEXT(open);
    va_list arguments;
    va_start(arguments, flags);
    mode_t mode = mode_of(flags, arguments);
    va_end(arguments);
    if (is_call("open") && is_path(path) && admitted(1) < 0) return -1;
    return next(path, flags, mode);
}

int open64(const char *path, int flags, ...) {
    NEXT(open64);
    va_list arguments;
    va_start(arguments, flags);
    mode_t mode = mode_of(flags, arguments);
    va_end(arguments);
    if (is_call("open") && is_path(path) && admitted(1) < 0) return -1;
    return next(path, flags, mode);
}
