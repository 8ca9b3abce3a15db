/* Counts, records and disturbs the system calls of a program on files below one folder. Loaded before the C library.
 *
 * SHIM_ROOT    the folder, absolute; calls on other files pass unseen
 * SHIM_TRACE   file that gets every call in order, with what it wrote: see `struct entry`
 * SHIM_HITS    file that gets a line for each fault
 * SHIM_MODE    error, short, full, delay, before (killed before the call) or after (killed after it)
 * SHIM_SITE    call and place, such as "write log" (`call_names`, `place_of`); without it, all
 * SHIM_AT      number of the call among those of the site, from 1
 * SHIM_EVERY   disturbs every so many-th call from SHIM_AT on instead of one
 * SHIM_TIMES   calls that a full disk refuses before there is room again
 * SHIM_DELAY_US  how long a delayed call waits
 * SHIM_LIE     syncs of files in this place, or "folder", do nothing and say that they have
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/sendfile.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum call { OPEN, READ, WRITE, SYNC, TRUNCATE, RENAME, REMOVE, MKDIR, LINK, LIST, SEND, CALLS };
static const char *const call_names[CALLS] = {"open",   "read",  "write", "sync", "truncate", "rename",
                                              "remove", "mkdir", "link",  "list", "send"};

/* Followed by both paths, the place and the data. */
struct entry {
    uint8_t call, creates, lies, unused;
    int32_t result;
    uint64_t inode;
    int64_t offset;
    uint32_t path, other_path, place, data;
};

#define MOST_FILES 4096
#define LONGEST 512
/* What a file descriptor stands for: 0 unknown yet, 1 a file below the root, 2 a connection, 3 anything else. */
static struct { char kind; char path[LONGEST]; } files[MOST_FILES];

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static char root[LONGEST];
static const char *mode, *site, *lie;
static long at, every, times, delay_us, seen, refused;
static int trace = -1, hits = -1, is_full;
static __thread int inside;

static long setting(const char *name, long without) {
    const char *text = getenv(name);
    return text ? atol(text) : without;
}

static int file_of(const char *name) {
    const char *path = getenv(name);
    return path ? (int)syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666) : -1;
}

__attribute__((constructor)) static void begin(void) {
    const char *folder = getenv("SHIM_ROOT");
    snprintf(root, sizeof root, "%s", folder ? folder : "");
    mode = getenv("SHIM_MODE");
    site = getenv("SHIM_SITE");
    lie = getenv("SHIM_LIE");
    at = setting("SHIM_AT", 0);
    every = setting("SHIM_EVERY", 0);
    times = setting("SHIM_TIMES", 1);
    delay_us = setting("SHIM_DELAY_US", 20000);
    trace = file_of("SHIM_TRACE");
    hits = file_of("SHIM_HITS");
}

/* The part of a path below the root; NULL for any other path. Relative paths are those of the working directory. */
static const char *below(const char *path) {
    size_t length = strlen(root);
    if (!length || !path)
        return NULL;
    if (path[0] != '/') {
        char folder[LONGEST];
        if (!getcwd(folder, sizeof folder) || strcmp(folder, root) != 0)
            return NULL;
        while (strncmp(path, "./", 2) == 0)
            path += 2;
        return strcmp(path, ".") == 0 ? "" : path;
    }
    if (strncmp(path, root, length) != 0 || (path[length] && path[length] != '/'))
        return NULL;
    path += length;
    return *path == '/' ? path + 1 : path;
}

static int begins(const char *text, const char *with) { return strncmp(text, with, strlen(with)) == 0; }

/* A word for what a file is for. */
static const char *place_of(const char *path) {
    if (begins(path, "armwatch.db-wal")) return "log";
    if (begins(path, "armwatch.db-shm")) return "index";
    if (begins(path, "armwatch.db-journal")) return "journal";
    if (begins(path, "armwatch.db.")) return "lock";
    if (begins(path, "armwatch.db")) return "database";
    if (begins(path, "inbox")) return "inbox";
    if (begins(path, "spool")) return "spool";
    if (begins(path, "archive")) return "archive";
    if (begins(path, "snapshot")) return "snapshot";
    return *path ? "settings" : "folder";
}

/* What a descriptor stands for, found out at its first use: path below the root, "" for a connection, or NULL. */
static const char *look_up(int fd) {
    if (fd < 0 || fd >= MOST_FILES)
        return NULL;
    if (files[fd].kind == 0) {
        char link[64], path[LONGEST];
        snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
        ssize_t length = readlink(link, path, sizeof path - 1);
        path[length > 0 ? length : 0] = 0;
        char *gone = strstr(path, " (deleted)");
        if (gone)
            *gone = 0;
        const char *rest = path[0] == '/' ? below(path) : NULL;
        struct sockaddr_storage address;
        socklen_t size = sizeof address;
        int is_network = begins(path, "socket:") && getsockname(fd, (struct sockaddr *)&address, &size) == 0 &&
                         (address.ss_family == AF_INET || address.ss_family == AF_INET6);
        files[fd].kind = rest ? 1 : is_network ? 2 : 3;
        snprintf(files[fd].path, LONGEST, "%s", rest ? rest : "");
    }
    return files[fd].kind == 3 ? NULL : files[fd].path;
}

static int is_connection(int fd) { return fd >= 0 && fd < MOST_FILES && files[fd].kind == 2; }

static void forget(int fd) {
    if (fd >= 0 && fd < MOST_FILES)
        files[fd].kind = 0;
}

static int takes_room(enum call call) { return call == WRITE || call == MKDIR || call == LINK || call == TRUNCATE; }

static int is_sync_of(const char *place, const char *path) {
    struct stat found;
    char whole[2 * LONGEST];
    if (!lie)
        return 0;
    if (strcmp(lie, "folder") != 0)
        return strcmp(lie, place) == 0;
    snprintf(whole, sizeof whole, "%s/%s", root, path);
    return stat(whole, &found) == 0 && S_ISDIR(found.st_mode);
}

/* One call, from its place in the order to its end. The lock is held where calls are recorded, so that the order of
 * entries is the order of effects. */
struct visit {
    enum call call;
    const char *path, *other, *place;
    int fails, kills, creates, lies;
};

/* Decides about a call; `count` are its bytes, which a fault may make fewer. */
static struct visit enter(enum call call, const char *path, const char *other, size_t *count, int creates) {
    const char *place = call == SEND ? "network" : place_of(path);
    struct visit visit = {call, path, other, place, 0, 0, creates, 0};
    inside = 1;
    pthread_mutex_lock(&lock);
    visit.lies = call == SYNC && is_sync_of(place, path);
    char name[64];
    snprintf(name, sizeof name, "%s %s", call_names[call], place);
    int is_hit = 0;
    if (mode && (!site || strcmp(site, name) == 0)) {
        seen++;
        is_hit = every > 0 ? seen >= at && (seen - at) % every == 0 : seen == at;
    }
    int is_short = is_hit && (strcmp(mode, "short") == 0 || strcmp(mode, "full") == 0);
    if (is_hit && strcmp(mode, "short") == 0 && !(count && *count > 1))
        is_hit = is_short = 0;
    if (is_full && refused < times && call != SEND && (takes_room(call) || creates)) {
        refused++;
        visit.fails = ENOSPC;
    }
    if (is_hit) {
        char line[LONGEST + 128];
        int length = snprintf(line, sizeof line, "%s %ld %s\n", name, seen, path);
        if (hits >= 0)
            syscall(SYS_write, hits, line, length);
        if (strcmp(mode, "error") == 0)
            visit.fails = call == SEND ? ECONNRESET : EIO;
        if (is_short && count && *count > 1)
            *count /= 2;
        else if (strcmp(mode, "full") == 0)
            visit.fails = ENOSPC, refused++;
        is_full |= strcmp(mode, "full") == 0;
        if (strcmp(mode, "before") == 0)
            kill(getpid(), SIGKILL), pause();
        visit.kills = strcmp(mode, "after") == 0;
    }
    int waits = is_hit && strcmp(mode, "delay") == 0;
    if (trace < 0)
        pthread_mutex_unlock(&lock);
    if (waits)
        usleep((useconds_t)delay_us);
    return visit;
}

/* Ends a call: records it, kills the process if that is due and gives its result. */
static long leave(struct visit *visit, long result, int fd, int64_t offset, const void *data) {
    int error = errno;
    if (visit->kills)
        kill(getpid(), SIGKILL), pause();
    if (trace >= 0) {
        struct stat found;
        struct entry entry = {0};
        int is_known = fd >= 0 && visit->call != SEND && fstat(fd, &found) == 0;
        entry.call = (uint8_t)visit->call;
        entry.creates = (uint8_t)visit->creates;
        entry.lies = (uint8_t)visit->lies;
        entry.result = (int32_t)result;
        entry.inode = is_known ? found.st_ino : (uint64_t)fd;
        entry.offset = offset;
        entry.path = (uint32_t)strlen(visit->path);
        entry.other_path = visit->other ? (uint32_t)strlen(visit->other) : 0;
        entry.place = (uint32_t)strlen(visit->place);
        entry.data = data && result > 0 ? (uint32_t)result : 0;
        struct iovec parts[] = {{&entry, sizeof entry},
                                {(void *)visit->path, entry.path},
                                {(void *)visit->other, entry.other_path},
                                {(void *)visit->place, entry.place},
                                {(void *)data, entry.data}};
        syscall(SYS_writev, trace, parts, 5);
        pthread_mutex_unlock(&lock);
    }
    inside = 0;
    errno = error;
    return result;
}

#define NEXT(name) \
    static __typeof__(&name) next; \
    if (!next) next = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

/* The file of a descriptor for a call that is not made by this library itself. */
#define FILE_OF(fd) (inside || !root[0] ? NULL : look_up(fd))

#define REFUSED(visit) (errno = (visit).fails, -1)

static long refuse(struct visit *visit) { return leave(visit, REFUSED(*visit), -1, 0, NULL); }

#define READS(name, ...) \
    const char *path = FILE_OF(fd); \
    if (!path || is_connection(fd)) return next(__VA_ARGS__); \
    struct visit visit = enter(READ, path, NULL, &count, 0); \
    if (visit.fails) return refuse(&visit); \
    return leave(&visit, next(__VA_ARGS__), fd, 0, NULL)

ssize_t read(int fd, void *buffer, size_t count) { NEXT(read); READS(read, fd, buffer, count); }
ssize_t pread(int fd, void *buffer, size_t count, off_t from) { NEXT(pread); READS(pread, fd, buffer, count, from); }
ssize_t pread64(int fd, void *buffer, size_t count, off64_t from) { NEXT(pread64); READS(pread64, fd, buffer, count, from); }

#define WRITES(where, ...) \
    const char *path = FILE_OF(fd); \
    if (!path) return next(__VA_ARGS__); \
    struct visit visit = enter(is_connection(fd) ? SEND : WRITE, path, NULL, &count, 0); \
    if (visit.fails) return refuse(&visit); \
    long written = next(__VA_ARGS__); \
    return leave(&visit, written, fd, where, buffer)

/* Where the bytes went that a write without an offset has just written. */
static int64_t behind(int fd, long written) {
    int64_t now = is_connection(fd) ? 0 : lseek(fd, 0, SEEK_CUR);
    return now - (written > 0 ? written : 0);
}

ssize_t write(int fd, const void *buffer, size_t count) { NEXT(write); WRITES(behind(fd, written), fd, buffer, count); }
ssize_t pwrite(int fd, const void *buffer, size_t count, off_t to) { NEXT(pwrite); WRITES(to, fd, buffer, count, to); }
ssize_t pwrite64(int fd, const void *buffer, size_t count, off64_t to) { NEXT(pwrite64); WRITES(to, fd, buffer, count, to); }
ssize_t send(int fd, const void *buffer, size_t count, int flags) { NEXT(send); WRITES(0, fd, buffer, count, flags); }

/* Several buffers become one, which the caller cannot tell from a short write. */
ssize_t writev(int fd, const struct iovec *parts, int number) {
    NEXT(writev);
    if (!FILE_OF(fd)) return next(fd, parts, number);
    size_t length = 0;
    for (int i = 0; i < number; i++) length += parts[i].iov_len;
    char *joined = malloc(length + 1);
    size_t end = 0;
    for (int i = 0; i < number; i++) {
        memcpy(joined + end, parts[i].iov_base, parts[i].iov_len);
        end += parts[i].iov_len;
    }
    ssize_t written = write(fd, joined, length);
    int error = errno;
    free(joined);
    errno = error;
    return written;
}

/* In the kernel there would be nothing to see: callers then read and write instead. */
ssize_t copy_file_range(int from, off64_t *from_at, int to, off64_t *to_at, size_t count, unsigned flags) {
    NEXT(copy_file_range);
    if (!FILE_OF(to)) return next(from, from_at, to, to_at, count, flags);
    errno = ENOSYS;
    return -1;
}

ssize_t sendfile64(int to, int from, off64_t *at_offset, size_t count) {
    NEXT(sendfile64);
    if (!FILE_OF(to) && !FILE_OF(from)) return next(to, from, at_offset, count);
    errno = EINVAL;
    return -1;
}

#define SYNCS() \
    const char *path = FILE_OF(fd); \
    if (!path) return next(fd); \
    struct visit visit = enter(SYNC, path, NULL, NULL, 0); \
    if (visit.fails) return (int)refuse(&visit); \
    return (int)leave(&visit, visit.lies ? 0 : next(fd), fd, 0, NULL)

int fsync(int fd) { NEXT(fsync); SYNCS(); }
int fdatasync(int fd) { NEXT(fdatasync); SYNCS(); }

#define TRUNCATES() \
    const char *path = FILE_OF(fd); \
    if (!path) return next(fd, length); \
    struct visit visit = enter(TRUNCATE, path, NULL, NULL, 0); \
    if (visit.fails) return (int)refuse(&visit); \
    return (int)leave(&visit, next(fd, length), fd, length, NULL)

int ftruncate(int fd, off_t length) { NEXT(ftruncate); TRUNCATES(); }
int ftruncate64(int fd, off64_t length) { NEXT(ftruncate64); TRUNCATES(); }

#define NAMES(call, whole, second, ...) \
    const char *path = inside ? NULL : below(whole), *other = second; \
    if (!path) return next(__VA_ARGS__); \
    struct visit visit = enter(call, path, other, NULL, 0); \
    if (visit.fails) return (int)refuse(&visit); \
    return (int)leave(&visit, next(__VA_ARGS__), -1, 0, NULL)

int rename(const char *from, const char *to) { NEXT(rename); NAMES(RENAME, from, below(to), from, to); }
int unlink(const char *name) { NEXT(unlink); NAMES(REMOVE, name, NULL, name); }
int rmdir(const char *name) { NEXT(rmdir); NAMES(REMOVE, name, NULL, name); }
int mkdir(const char *name, mode_t bits) { NEXT(mkdir); NAMES(MKDIR, name, NULL, name, bits); }
int link(const char *from, const char *to) { NEXT(link); NAMES(LINK, from, below(to), from, to); }

DIR *opendir(const char *name) {
    NEXT(opendir);
    const char *path = inside ? NULL : below(name);
    if (!path) return next(name);
    struct visit visit = enter(LIST, path, NULL, NULL, 0);
    if (visit.fails) { refuse(&visit); return NULL; }
    DIR *folder = next(name);
    leave(&visit, folder ? 0 : -1, -1, 0, NULL);
    return folder;
}

static mode_t bits_of(int flags, va_list arguments) {
    return (flags & O_CREAT) || (flags & O_TMPFILE) == O_TMPFILE ? va_arg(arguments, mode_t) : 0;
}

/* An open that makes a file is an entry with `creates`; one that empties a file is a truncation as well. */
#define OPENS(...) \
    va_list arguments; \
    va_start(arguments, flags); \
    mode_t bits = bits_of(flags, arguments); \
    va_end(arguments); \
    const char *path = inside ? NULL : below(name); \
    if (!path) return next(__VA_ARGS__); \
    struct stat found; \
    int creates = (flags & O_CREAT) && stat(name, &found) != 0; \
    struct visit visit = enter(OPEN, path, NULL, NULL, creates); \
    if (visit.fails) return (int)refuse(&visit); \
    int fd = next(__VA_ARGS__); \
    forget(fd); \
    return (int)leave(&visit, fd, fd, flags & O_TRUNC ? 1 : 0, NULL)

int open(const char *name, int flags, ...) { NEXT(open); OPENS(name, flags, bits); }
int open64(const char *name, int flags, ...) { NEXT(open64); OPENS(name, flags, bits); }

int close(int fd) {
    NEXT(close);
    forget(fd);
    return next(fd);
}
