/* Sets a program's clock apart: the system's time, SAGOMA_CLOCK_AHEAD_NS nanoseconds later (bench/hosts_clients.py).
 *
 *     cc -shared -fPIC -O2 -o clock.so hosts_clock.c; SAGOMA_CLOCK_AHEAD_NS=2000000000 LD_PRELOAD=./clock.so PROGRAM
 *
 * Linux has no time namespace for the time of day. What runs by monotonic clocks (timeouts, DDS) is not touched.
 */
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SECOND_NS 1000000000LL

static long long ahead_ns;

__attribute__((constructor)) static void begin(void)
{
    const char *given = getenv("SAGOMA_CLOCK_AHEAD_NS");
    ahead_ns = given ? atoll(given) : 0;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    const int failed = syscall(SYS_clock_gettime, clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
        const long long ns = now->tv_sec * SECOND_NS + now->tv_nsec + ahead_ns;
        now->tv_sec = ns / SECOND_NS;
        now->tv_nsec = ns % SECOND_NS;
    }
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    struct timespec precise;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &precise);
    now->tv_sec = precise.tv_sec;
    now->tv_usec = precise.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *out)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (out)
        *out = now.tv_sec;
    return now.tv_sec;
}
