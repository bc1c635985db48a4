/* pool.c - see pool.h. A job is a counter of chunks: whoever is free takes the next one. */
#include "pool.h"
#include <pthread.h>
#include <stdlib.h>

/* The two words that are read without the lock. Everything else is guarded by it. */
#define EX_LOAD(x) __atomic_load_n(&(x), __ATOMIC_ACQUIRE)
#define EX_STORE(x, v) __atomic_store_n(&(x), v, __ATOMIC_RELEASE)
#define EX_TAKE(x) __atomic_fetch_add(&(x), 1, __ATOMIC_ACQ_REL)
#if defined(__x86_64__) || defined(__i386__)
   #define EX_PAUSE() __builtin_ia32_pause()
#else
   #define EX_PAUSE() ((void)0)
#endif
enum { EX_LOOKS = 600, EX_CHUNKS = 4 }; /* looks before sleeping; chunks a worker: evens out unequal ranges */

typedef struct ex_worker {
   ex_pool *pool;
   pthread_t thread;
   unsigned number;
} ex_worker;

struct ex_pool {
   pthread_mutex_t busy;       /* one job at a time */
   pthread_mutex_t lock;
   pthread_cond_t wake, done;
   unsigned threads, started;  /* asked for; workers that run (the caller is not among them) */
   unsigned job_number;        /* counts jobs; read without the lock while looking out */
   unsigned asleep, active;    /* workers waiting on wake; workers inside the job */
   int open, stop;             /* the job may still be joined; leave */
   size_t count, step, chunks; /* the job */
   size_t next;                /* chunk to take; without the lock */
   dn_range_fn *fn;
   void *job;
   ex_worker *worker;
};

static void ex_work(ex_pool *p, unsigned number)
{
   size_t c;
   while ((c = EX_TAKE(p->next)) < p->chunks) {
      size_t begin = c * p->step, end = p->count - begin > p->step ? begin + p->step : p->count;
      p->fn(p->job, begin, end, number);
   }
}

static void *ex_worker_main(void *user)
{
   ex_worker *w = (ex_worker *)user;
   ex_pool *p = w->pool;
   unsigned seen = 0;
   int stop = 0;
   while (!stop) {
      int look;
      for (look = 0; look < EX_LOOKS && EX_LOAD(p->job_number) == seen; look++) EX_PAUSE();
      pthread_mutex_lock(&p->lock);
      while (p->job_number == seen && !p->stop) {
         p->asleep++;
         pthread_cond_wait(&p->wake, &p->lock);
         p->asleep--;
      }
      seen = p->job_number;
      stop = p->stop;
      if (p->open && !stop) { /* closed already: the others did it all */
         p->active++;
         pthread_mutex_unlock(&p->lock);
         ex_work(p, w->number);
         pthread_mutex_lock(&p->lock);
         if (--p->active == 0) pthread_cond_signal(&p->done);
      }
      pthread_mutex_unlock(&p->lock);
   }
   return NULL;
}

static void ex_pool_run(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   ex_pool *p = (ex_pool *)user;
   size_t units, share;
   if (grain == 0) grain = 1;
   units = count / grain + (count % grain != 0);
   share = units / ((size_t)p->threads * EX_CHUNKS);
   pthread_mutex_lock(&p->busy);
   pthread_mutex_lock(&p->lock);
   p->count = count;
   p->step = grain * (share ? share : 1);
   p->chunks = count / p->step + (count % p->step != 0);
   p->fn = fn;
   p->job = job;
   EX_STORE(p->next, (size_t)0);
   p->open = 1;
   EX_STORE(p->job_number, p->job_number + 1);
   if (p->asleep) pthread_cond_broadcast(&p->wake);
   pthread_mutex_unlock(&p->lock);
   ex_work(p, 0);
   pthread_mutex_lock(&p->lock);
   p->open = 0; /* who has not joined by now would find nothing to do */
   while (p->active) pthread_cond_wait(&p->done, &p->lock);
   pthread_mutex_unlock(&p->lock);
   pthread_mutex_unlock(&p->busy);
}

ex_pool *ex_pool_create(unsigned threads)
{
   ex_pool *p = (ex_pool *)calloc(1, sizeof *p);
   if (!p) return NULL;
   p->threads = threads ? threads : 1;
   p->worker = (ex_worker *)calloc(p->threads, sizeof *p->worker);
   pthread_mutex_init(&p->busy, NULL);
   pthread_mutex_init(&p->lock, NULL);
   pthread_cond_init(&p->wake, NULL);
   pthread_cond_init(&p->done, NULL);
   while (p->worker && p->started + 1 < p->threads) {
      ex_worker *w = &p->worker[p->started];
      w->pool = p;
      w->number = p->started + 1;
      if (pthread_create(&w->thread, NULL, ex_worker_main, w)) break;
      p->started++;
   }
   if (p->worker && p->started + 1 == p->threads) return p;
   ex_pool_free(p);
   return NULL;
}

void ex_pool_free(ex_pool *p)
{
   unsigned i;
   if (!p) return;
   pthread_mutex_lock(&p->lock);
   p->stop = 1;
   EX_STORE(p->job_number, p->job_number + 1);
   pthread_cond_broadcast(&p->wake);
   pthread_mutex_unlock(&p->lock);
   for (i = 0; i < p->started; i++) pthread_join(p->worker[i].thread, NULL);
   pthread_cond_destroy(&p->done);
   pthread_cond_destroy(&p->wake);
   pthread_mutex_destroy(&p->lock);
   pthread_mutex_destroy(&p->busy);
   free(p->worker);
   free(p);
}

dn_parallel ex_pool_parallel(ex_pool *pool)
{
   dn_parallel par;
   par.run = pool ? ex_pool_run : NULL;
   par.user = pool;
   par.workers = pool ? pool->threads : 1;
   return par;
}
