/* quiet.c - see quiet.h */
#include "quiet.h"
#include "tool.h"
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { EX_TASKS = 256 };

struct ex_quiet {
   double share, tick;     /* seconds of one count of /proc/stat */
   long processors;
   int tasks, blind;
   long task[EX_TASKS];    /* this process' threads */
   double start, busy, own, waited; /* at ex_quiet_begin, seconds */
   size_t made, counted;
};

static double ex_own(void) /* processor seconds of all threads */
{
   struct timespec t;
   clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
   return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}
static int ex_busy(double tick, double *seconds) /* of all processors so far: user, nice, system, irq, softirq, stolen */
{
   unsigned long long v[8];
   FILE *f = fopen("/proc/stat", "r");
   int n = f ? fscanf(f, "cpu %llu %llu %llu %llu %llu %llu %llu %llu", v, v + 1, v + 2, v + 3, v + 4, v + 5, v + 6, v + 7) : 0;
   if (f) fclose(f);
   if (n != 8) return 0;
   *seconds = (double)(v[0] + v[1] + v[2] + v[5] + v[6] + v[7]) * tick;
   return 1;
}
static int ex_waited(const ex_quiet *q, double *seconds) /* ready, but without a processor */
{
   int k, found = 0;
   *seconds = 0;
   for (k = 0; k < q->tasks; k++) {
      char path[64];
      unsigned long long ran, waited;
      FILE *f;
      snprintf(path, sizeof path, "/proc/self/task/%ld/schedstat", q->task[k]);
      f = fopen(path, "r");
      if (!f) continue;
      if (fscanf(f, "%llu %llu", &ran, &waited) == 2) *seconds += (double)waited * 1e-9, found++;
      fclose(f);
   }
   return found > 0;
}

ex_quiet *ex_quiet_create(double share)
{
   ex_quiet *q = (ex_quiet *)calloc(1, sizeof *q);
   DIR *d = q ? opendir("/proc/self/task") : NULL;
   struct dirent *e;
   double unused;
   if (!q) return NULL;
   q->share = share;
   q->tick = 1.0 / (double)sysconf(_SC_CLK_TCK);
   q->processors = sysconf(_SC_NPROCESSORS_ONLN);
   while (d && (e = readdir(d)) != NULL)
      if (e->d_name[0] != '.' && q->tasks < EX_TASKS) q->task[q->tasks++] = strtol(e->d_name, NULL, 10);
   if (d) closedir(d);
   q->blind = !ex_busy(q->tick, &unused) || !ex_waited(q, &unused);
   return q;
}
void ex_quiet_free(ex_quiet *q) { free(q); }
int ex_quiet_blind(const ex_quiet *q) { return q->blind; }
size_t ex_quiet_made(const ex_quiet *q) { return q->made; }
size_t ex_quiet_counted(const ex_quiet *q) { return q->counted; }

void ex_quiet_begin(ex_quiet *q)
{
   if (!q->blind) {
      ex_busy(q->tick, &q->busy);
      ex_waited(q, &q->waited);
   }
   q->own = ex_own();
   q->start = ex_now_ms();
}
int ex_quiet_end(ex_quiet *q)
{
   double took = (ex_now_ms() - q->start) * 1e-3, own = ex_own() - q->own, busy = 0, waited = 0;
   int counts = 1;
   if (!q->blind) {
      ex_busy(q->tick, &busy);
      ex_waited(q, &waited);
      counts = busy - q->busy - own <= (q->share * took + q->tick) * (double)q->processors && waited - q->waited <= q->share * took;
   }
   q->made++;
   q->counted += (size_t)counts;
   return counts;
}

void ex_times_add(ex_times *t, double ms, int counts)
{
   int k;
   for (k = counts ? 0 : 1; k < 2; k++) {
      if (t->n[k] == t->room[k]) {
         double *more = (double *)realloc(t->ms[k], (t->room[k] = 2 * t->room[k] + 16) * sizeof *more);
         if (!more) {
            fputs("out of memory\n", stderr);
            exit(1);
         }
         t->ms[k] = more;
      }
      t->ms[k][t->n[k]++] = ms;
   }
}
static int ex_by_size(const void *a, const void *b)
{
   double x = *(const double *)a, y = *(const double *)b;
   return (x > y) - (x < y);
}
double ex_times_at(ex_times *t, double part)
{
   int k = t->n[0] == 0;
   double at = part * (double)(t->n[k] ? t->n[k] - 1 : 0);
   size_t i = (size_t)at;
   if (t->n[k] == 0) return 0;
   qsort(t->ms[k], t->n[k], sizeof *t->ms[k], ex_by_size);
   return t->ms[k][i] + (at - (double)i) * (t->ms[k][i + 1 < t->n[k] ? i + 1 : i] - t->ms[k][i]);
}
void ex_times_clear(ex_times *t)
{
   free(t->ms[0]);
   free(t->ms[1]);
   memset(t, 0, sizeof *t);
}
