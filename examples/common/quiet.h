/*  quiet.h - times of runs during which nothing else kept the processors busy

    shows     how to tell, on a shared machine, a run that was disturbed from one that was not
    counts    a run when the other processes used no more processor time than a share of it, and this process' own threads
              waited for a processor no longer than that: /proc/stat and /proc/self/task/N/schedstat. The first is counted in
              hundredths of a second, so one of those per processor is let pass
    elsewhere without those files every run counts, and ex_quiet_blind says so
    cost      some ten microseconds a run */
#ifndef EX_QUIET_H
#define EX_QUIET_H
#include <stddef.h>

typedef struct ex_quiet ex_quiet;
/*  start it once all threads run; share: 0.05 lets others have a twentieth of the run's time. NULL: out of memory */
ex_quiet *ex_quiet_create(double share);
void ex_quiet_free(ex_quiet *q); /* NULL is allowed */
int ex_quiet_blind(const ex_quiet *q);
void ex_quiet_begin(ex_quiet *q);
/*  whether the run since ex_quiet_begin counts; made and counted runs are added up */
int ex_quiet_end(ex_quiet *q);
size_t ex_quiet_made(const ex_quiet *q), ex_quiet_counted(const ex_quiet *q);

/* --- what the runs took. Quantiles are of the runs that counted, or, when none did, of all; then `counted` is 0 */
typedef struct ex_times { double *ms[2]; size_t n[2], room[2]; } ex_times; /* 0: counted, 1: all. Zero-filled: empty */
void ex_times_add(ex_times *t, double ms, int counts); /* exits when memory runs out */
double ex_times_at(ex_times *t, double part);          /* 0 least, 0.5 median, 1 most; 0 when empty. Sorts */
void ex_times_clear(ex_times *t);                      /* gives the memory back */

#endif
