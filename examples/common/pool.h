/*  pool.h - a small thread pool that serves as deformnet's dn_parallel
    shows     how to plug a job system into the library; yours replaces this one
    contract  ranges are disjoint, cover [0,count), are cut on multiples of grain; the calling thread is worker 0
    waiting   a worker without work looks out for the next job for some tens of microseconds, then sleeps; so does the caller
              for those who have not finished
    threads   POSIX, with gcc's and clang's atomics; compiled with -DEX_POOL_C11 -std=c11, those of the C11 standard
    limits    one job at a time (a second caller waits); no job may start another on its pool */
#ifndef EX_POOL_H
#define EX_POOL_H
#include "../../deformnet.h"

typedef struct ex_pool ex_pool;
/*  threads in all, the caller's included; NULL when memory or threads run out */
ex_pool *ex_pool_create(unsigned threads);
void ex_pool_free(ex_pool *pool); /* NULL is allowed */
/*  what to hand to dn_deform and dn_rig_create; a NULL pool gives the empty dn_parallel (no threads) */
dn_parallel ex_pool_parallel(ex_pool *pool);

#endif
