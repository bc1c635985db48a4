/*  pool.c - the examples' thread pool keeps the promises that dn_parallel asks of it

    shows   every index is done once, by one worker at a time, on cuts of the grain; jobs one after another, from several
            threads at once, with more workers than ranges; freeing a pool that has never run
    build   cc -O2 pool.c -o pool -lpthread        POSIX threads; pool_c11.c is the same with C11's */
#ifndef POOL_C11
   #define _POSIX_C_SOURCE 200809L
#endif
#include "../examples/common/pool.c"
#include "test.h"
#include <pthread.h>

enum { MOST = 5000, WORKERS = 7 };
typedef struct tally {
   unsigned char done[MOST];         /* how often each index was done: ranges must not meet */
   int inside[WORKERS];              /* a worker number twice at once would raise this to 2 */
   size_t count, grain, bad, ranges[WORKERS];
   unsigned workers;
} tally;
static void tally_range(void *user, size_t begin, size_t end, unsigned worker)
{
   tally *t = (tally *)user;
   size_t i;
   volatile size_t k;
   if (worker >= t->workers || begin >= end || end > t->count || begin % t->grain || (end != t->count && end % t->grain)) {
      __atomic_fetch_add(&t->bad, 1, __ATOMIC_RELAXED);
      return;
   }
   if (__atomic_add_fetch(&t->inside[worker], 1, __ATOMIC_ACQ_REL) != 1) __atomic_fetch_add(&t->bad, 1, __ATOMIC_RELAXED);
   for (i = begin; i < end; i++) {
      t->done[i]++;
      for (k = 0; k < 50 * (i % 5); k++) {} /* ranges take unequal time */
   }
   t->ranges[worker]++;
   __atomic_sub_fetch(&t->inside[worker], 1, __ATOMIC_ACQ_REL);
}
static size_t run_once(const dn_parallel *par, size_t count, size_t grain)
{
   static const tally empty;
   tally *t = (tally *)test_block(sizeof *t);
   size_t i, bad;
   *t = empty;
   t->count = count, t->grain = grain, t->workers = par->workers;
   par->run(par->user, count, grain, tally_range, t);
   bad = t->bad;
   for (i = 0; i < MOST; i++) bad += t->done[i] != (i < count);
   free(t);
   return bad;
}

TEST(every_index_once_on_cuts_of_the_grain)
{
   unsigned threads;
   size_t jobs = 0;
   uint64_t seed = 1;
   for (threads = 1; threads <= WORKERS; threads++) {
      ex_pool *p = ex_pool_create(threads);
      dn_parallel par = ex_pool_parallel(p);
      size_t k;
      CHECK(p != NULL && par.workers == threads);
      for (k = 0; p && k < 300; k++, jobs++) {
         size_t count = k < 20 ? k : test_random(&seed) % MOST, grain = 1 + test_random(&seed) % (k % 3 ? 9 : 2000);
         CHECK_MSG(run_once(&par, count, grain) == 0, "%u threads, %lu by %lu", threads, (unsigned long)count, (unsigned long)grain);
      }
      ex_pool_free(p);
   }
   AT_LEAST(jobs, 2000, "jobs");
}
TEST(a_job_waits_until_all_its_ranges_are_done)
{
   ex_pool *p = ex_pool_create(3);
   dn_parallel par = ex_pool_parallel(p);
   size_t k;
   CHECK(p != NULL);
   for (k = 0; p && k < 20000; k++) /* one or two short ranges: workers arrive while the job is already over */
      if (!CHECK(run_once(&par, 1 + k % 3, 1) == 0)) break;
   ex_pool_free(p);
}
typedef struct caller { dn_parallel par; size_t bad; } caller;
static void *caller_main(void *user)
{
   caller *c = (caller *)user;
   size_t k;
   for (k = 0; k < 300; k++) c->bad += run_once(&c->par, 200 + k, 7);
   return NULL;
}
TEST(callers_take_turns)
{
   ex_pool *p = ex_pool_create(2);
   caller c[3];
   pthread_t thread[3];
   size_t k, started = 0;
   for (k = 0; p && k < 3; k++) {
      c[k].par = ex_pool_parallel(p), c[k].bad = 0;
      started += pthread_create(&thread[k], NULL, caller_main, &c[k]) == 0;
   }
   CHECK(started == 3);
   for (k = 0; k < started; k++) {
      pthread_join(thread[k], NULL);
      CHECK(c[k].bad == 0);
   }
   ex_pool_free(p);
}
TEST(pools_come_and_go)
{
   size_t k;
   dn_parallel none = ex_pool_parallel(NULL);
   CHECK(none.run == NULL && none.workers == 1);
   for (k = 0; k < 200; k++) {
      ex_pool *p = ex_pool_create((unsigned)(k % 5)); /* 0 counts as 1 */
      CHECK(p != NULL && ex_pool_parallel(p).workers == (k % 5 ? k % 5 : 1));
      ex_pool_free(p);
   }
   ex_pool_free(NULL);
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(every_index_once_on_cuts_of_the_grain);
   RUN(a_job_waits_until_all_its_ranges_are_done);
   RUN(callers_take_turns);
   RUN(pools_come_and_go);
   return TEST_END();
}
