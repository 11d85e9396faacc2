/* Number the system calls of a process that write below a folder, and let one of them fail.
 *
 * arm() installs a seccomp filter that reports these calls to a helper process. The helper lets them pass, answers with
 * an error in their place, kills the process, or lets it wait. So calls of libraries in C are met, too.
 * Linux 5.9 or newer. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <poll.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum { LONGEST = 240, KILL = -1, PAUSE = -2 };

struct call { int number; char path[LONGEST]; };
/* Shared with the parent: numbers of calls, whether the process waits and may go on, and the calls themselves. */
struct record { int count; int most; volatile int paused; volatile int go; struct call calls[]; };

/* Calls with a descriptor in the first argument, with a path there, and with a folder and a path. */
static const int BY_DESCRIPTOR[] = {SYS_write, SYS_pwrite64, SYS_writev, SYS_pwritev, SYS_fsync, SYS_fdatasync,
                                    SYS_ftruncate, SYS_fallocate, SYS_sendfile};
static const int BY_FOLDER[] = {SYS_openat, SYS_mkdirat, SYS_renameat2, SYS_symlinkat, SYS_linkat, SYS_unlinkat,
#ifdef SYS_renameat
                                SYS_renameat,
#endif
};
static const int BY_PATH[] = {
#ifdef SYS_rename
    SYS_rename, SYS_mkdir, SYS_open, SYS_creat, SYS_unlink, SYS_rmdir,
#endif
    -1};
#define LENGTH(a) ((int)(sizeof(a) / sizeof((a)[0])))

static int among(int number, const int *list, int n) {
    for (int k = 0; k < n; k++)
        if (list[k] == number) return 1;
    return 0;
}

/* Whether a call removes a file or folder. */
int removes(int number) {
    static const int REMOVALS[] = {
#ifdef SYS_unlink
        SYS_unlink, SYS_rmdir,
#endif
        SYS_unlinkat};
    return among(number, REMOVALS, LENGTH(REMOVALS));
}

static int filter(void) {
    int numbers[64], n = 0, size = 0;
    struct sock_filter code[256];
    for (int k = 0; k < LENGTH(BY_DESCRIPTOR); k++) numbers[n++] = BY_DESCRIPTOR[k];
    for (int k = 0; k < LENGTH(BY_FOLDER); k++) numbers[n++] = BY_FOLDER[k];
    for (int k = 0; k < LENGTH(BY_PATH); k++)
        if (BY_PATH[k] >= 0) numbers[n++] = BY_PATH[k];
    code[size++] = (struct sock_filter)BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr));
    for (int k = 0; k < n; k++) {
        int flags = numbers[k] == SYS_openat ? 2 : -1;
#ifdef SYS_open
        if (numbers[k] == SYS_open) flags = 1;
#endif
        if (flags < 0) {
            code[size++] = (struct sock_filter)BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, numbers[k], 0, 1);
        } else { /* opening is writing only if it may make a file */
            code[size++] = (struct sock_filter)BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, numbers[k], 0, 4);
            code[size++] = (struct sock_filter)BPF_STMT(BPF_LD | BPF_W | BPF_ABS,
                                                        offsetof(struct seccomp_data, args) + 8 * flags);
            code[size++] = (struct sock_filter)BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, O_CREAT | O_TRUNC, 1, 0);
            code[size++] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW);
        }
        code[size++] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_USER_NOTIF);
    }
    code[size++] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW);
    struct sock_fprog program = {(unsigned short)size, code};
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)) return -1;
    return (int)syscall(SYS_seccomp, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_NEW_LISTENER, &program);
}

static void text_at(int pid, unsigned long long address, char *out) {
    struct iovec own = {out, LONGEST - 1}, there = {(void *)address, LONGEST - 1};
    memset(out, 0, LONGEST);
    ssize_t n = process_vm_readv(pid, &own, 1, &there, 1, 0);
    if (n < 0) { /* a page ends after the text */
        there.iov_len = own.iov_len = 4096 - address % 4096 < LONGEST - 1 ? 4096 - address % 4096 : LONGEST - 1;
        process_vm_readv(pid, &own, 1, &there, 1, 0);
    }
}

static void link_of(const char *name, char *out) {
    ssize_t n = readlink(name, out, LONGEST - 1);
    out[n < 0 ? 0 : n] = 0;
}

static void path_of(const struct seccomp_notif *call, char *out) {
    char name[64], text[LONGEST], folder[LONGEST];
    int number = call->data.nr, at = among(number, BY_FOLDER, LENGTH(BY_FOLDER));
    if (among(number, BY_DESCRIPTOR, LENGTH(BY_DESCRIPTOR))) {
        snprintf(name, sizeof name, "/proc/%d/fd/%d", call->pid, (int)call->data.args[0]);
        link_of(name, out);
        return;
    }
    text_at(call->pid, call->data.args[at], text);
    if (text[0] == '/') {
        snprintf(out, LONGEST, "%s", text);
        return;
    }
    int descriptor = at ? (int)call->data.args[0] : AT_FDCWD;
    if (descriptor == AT_FDCWD) snprintf(name, sizeof name, "/proc/%d/cwd", call->pid);
    else snprintf(name, sizeof name, "/proc/%d/fd/%d", call->pid, descriptor);
    link_of(name, folder);
    snprintf(out, 2 * LONGEST, "%.*s/%.*s", LONGEST / 2 - 2, folder, LONGEST / 2 - 2, text);
}

static void serve(int listener, pid_t process, const char *root, int nth, int error, int sticky, struct record *record) {
    struct seccomp_notif call;
    char path[2 * LONGEST];
    for (;;) {
        struct pollfd ready = {listener, POLLIN, 0};
        if (poll(&ready, 1, -1) < 0 || !(ready.revents & POLLIN)) _exit(0);
        memset(&call, 0, sizeof call);
        if (ioctl(listener, SECCOMP_IOCTL_NOTIF_RECV, &call)) continue;
        struct seccomp_notif_resp answer = {call.id, 0, 0, SECCOMP_USER_NOTIF_FLAG_CONTINUE};
        path_of(&call, path);
        if (!strncmp(path, root, strlen(root))) {
            int own = ++record->count;
            if (own <= record->most) {
                record->calls[own - 1].number = call.data.nr;
                snprintf(record->calls[own - 1].path, LONGEST, "%s", path + strlen(root));
            }
            if (nth > 0 && (own == nth || (sticky && own > nth))) {
                if (error == KILL) {
                    kill(process, SIGKILL);
                    _exit(0);
                }
                if (error == PAUSE) {
                    record->paused = 1;
                    while (!record->go) usleep(500);
                    ioctl(listener, SECCOMP_IOCTL_NOTIF_SEND, &answer);
                    continue;
                }
                answer.error = -error;
                answer.flags = 0;
            }
        }
        ioctl(listener, SECCOMP_IOCTL_NOTIF_SEND, &answer);
    }
}

/* Number the calls of this process from now on; the nth one fails with an error (-1: SIGKILL, -2: it waits until the
 * parent lets it go on), and all after it if sticky. Returns 0, or the number of an error. */
int arm(const char *root, int nth, int error, int sticky, struct record *record) {
    pid_t process = getpid();
    int listener = filter();
    if (listener < 0) return errno;
    pid_t helper = fork();
    if (helper < 0) return errno;
    if (!helper) {
        prctl(PR_SET_PDEATHSIG, SIGKILL); /* it counts as a user of the filter: the end of the others is not reported */
        if (getppid() != process) _exit(0);
        for (int k = 0; k < 1024; k++)
            if (k != listener) close(k);
        serve(listener, process, root, nth, error, sticky, record);
    }
    prctl(PR_SET_PTRACER, helper, 0, 0, 0);
    close(listener);
    return 0;
}
