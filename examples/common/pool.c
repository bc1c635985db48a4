/* pool.c - see pool.h. A job is a counter of chunks: whoever is free takes the next one. */
#include "pool.h"
#include <stdlib.h>

/* Words that are read and written without the lock, in one order for all threads: LOAD, STORE and ADD (the value before)
   are theirs. What else the threads share is guarded by it, or written before open is set and read after. */
#ifdef EX_POOL_C11
   #include <stdatomic.h>
   #include <threads.h>
typedef mtx_t ex_mutex;
typedef cnd_t ex_condition;
typedef thrd_t ex_thread;
typedef int ex_main_result;
typedef atomic_uint ex_word;
typedef atomic_size_t ex_counter;
   #define EX_LOAD(x) atomic_load(&(x))
   #define EX_STORE(x, v) atomic_store(&(x), v)
   #define EX_ADD(x, v) atomic_fetch_add(&(x), v)
static int ex_mutex_create(ex_mutex *m) { return mtx_init(m, mtx_plain) == thrd_success; }
static void ex_mutex_free(ex_mutex *m) { mtx_destroy(m); }
static void ex_lock(ex_mutex *m) { mtx_lock(m); }
static void ex_unlock(ex_mutex *m) { mtx_unlock(m); }
static int ex_condition_create(ex_condition *c) { return cnd_init(c) == thrd_success; }
static void ex_condition_free(ex_condition *c) { cnd_destroy(c); }
static void ex_wait(ex_condition *c, ex_mutex *m) { cnd_wait(c, m); }
static void ex_signal(ex_condition *c) { cnd_signal(c); }
static void ex_broadcast(ex_condition *c) { cnd_broadcast(c); }
static int ex_thread_create(ex_thread *t, ex_main_result (*fn)(void *), void *user) { return thrd_create(t, fn, user) == thrd_success; }
static void ex_thread_join(ex_thread t) { thrd_join(t, NULL); }
#else
   #include <pthread.h>
typedef pthread_mutex_t ex_mutex;
typedef pthread_cond_t ex_condition;
typedef pthread_t ex_thread;
typedef void *ex_main_result;
typedef unsigned ex_word;
typedef size_t ex_counter;
   #define EX_LOAD(x) __atomic_load_n(&(x), __ATOMIC_SEQ_CST)
   #define EX_STORE(x, v) __atomic_store_n(&(x), v, __ATOMIC_SEQ_CST)
   #define EX_ADD(x, v) __atomic_fetch_add(&(x), v, __ATOMIC_SEQ_CST)
static int ex_mutex_create(ex_mutex *m) { return pthread_mutex_init(m, NULL) == 0; }
static void ex_mutex_free(ex_mutex *m) { pthread_mutex_destroy(m); }
static void ex_lock(ex_mutex *m) { pthread_mutex_lock(m); }
static void ex_unlock(ex_mutex *m) { pthread_mutex_unlock(m); }
static int ex_condition_create(ex_condition *c) { return pthread_cond_init(c, NULL) == 0; }
static void ex_condition_free(ex_condition *c) { pthread_cond_destroy(c); }
static void ex_wait(ex_condition *c, ex_mutex *m) { pthread_cond_wait(c, m); }
static void ex_signal(ex_condition *c) { pthread_cond_signal(c); }
static void ex_broadcast(ex_condition *c) { pthread_cond_broadcast(c); }
static int ex_thread_create(ex_thread *t, ex_main_result (*fn)(void *), void *user) { return pthread_create(t, NULL, fn, user) == 0; }
static void ex_thread_join(ex_thread t) { pthread_join(t, NULL); }
#endif
#if defined(__x86_64__) || defined(__i386__)
   #define EX_PAUSE() __builtin_ia32_pause()
#else
   #define EX_PAUSE() ((void)0)
#endif
/* looks before sleeping: some tens of microseconds, for a frame is many short jobs with less than that between them, and
   waking a thread takes as long. Chunks a worker: evens out unequal ranges */
enum { EX_LOOKS = 3000, EX_CHUNKS = 16 };

typedef struct ex_worker {
   ex_pool *pool;
   ex_thread thread;
   unsigned number;
} ex_worker;

struct ex_pool {
   ex_mutex busy;              /* one job at a time */
   ex_mutex lock;              /* for going to sleep and waking */
   ex_condition wake, done;
   unsigned threads, started;  /* asked for; workers that run (the caller is not among them) */
   ex_word job_number, stop;   /* counts jobs, and the end */
   ex_word open, active;       /* the job may be joined; workers that are in it, or looking whether they may */
   unsigned asleep;            /* workers waiting on wake */
   int ready;                  /* locks and conditions made, of 4 */
   size_t count, step, chunks; /* the job */
   ex_counter next;            /* chunk to take */
   dn_range_fn *fn;
   void *job;
   ex_worker *worker;
};

static void ex_work(ex_pool *p, unsigned number)
{
   size_t c;
   while ((c = EX_ADD(p->next, 1)) < p->chunks) {
      size_t begin = c * p->step, end = p->count - begin > p->step ? begin + p->step : p->count;
      p->fn(p->job, begin, end, number);
   }
}

/* A worker counts itself in before it looks whether the job is open; the caller closes the job before it looks whether
   anyone is in: whoever comes second sees the other, so that nobody is in a job that its caller has left. */
static ex_main_result ex_worker_main(void *user)
{
   ex_worker *w = (ex_worker *)user;
   ex_pool *p = w->pool;
   unsigned seen = 0;
   for (;;) {
      int look;
      for (look = 0; look < EX_LOOKS && EX_LOAD(p->job_number) == seen; look++) EX_PAUSE();
      if (EX_LOAD(p->job_number) == seen) {
         ex_lock(&p->lock);
         p->asleep++;
         while (EX_LOAD(p->job_number) == seen) ex_wait(&p->wake, &p->lock);
         p->asleep--;
         ex_unlock(&p->lock);
      }
      seen = EX_LOAD(p->job_number);
      if (EX_LOAD(p->stop)) return 0;
      EX_ADD(p->active, 1);
      if (EX_LOAD(p->open)) ex_work(p, w->number);
      if (EX_ADD(p->active, (unsigned)-1) == 1 && !EX_LOAD(p->open)) { /* the last one: the caller may be asleep */
         ex_lock(&p->lock);
         ex_signal(&p->done);
         ex_unlock(&p->lock);
      }
   }
}
static void ex_announce(ex_pool *p)
{
   EX_ADD(p->job_number, 1);
   ex_lock(&p->lock);
   if (p->asleep) ex_broadcast(&p->wake);
   ex_unlock(&p->lock);
}

static void ex_pool_run(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   ex_pool *p = (ex_pool *)user;
   size_t units, share;
   int look;
   if (grain == 0) grain = 1;
   units = count / grain + (count % grain != 0);
   share = units / ((size_t)p->threads * EX_CHUNKS);
   ex_lock(&p->busy);
   p->count = count;
   p->step = grain * (share ? share : 1);
   p->chunks = count / p->step + (count % p->step != 0);
   p->fn = fn;
   p->job = job;
   EX_STORE(p->next, (size_t)0);
   EX_STORE(p->open, 1u);
   ex_announce(p);
   ex_work(p, 0);
   EX_STORE(p->open, 0u);
   for (look = 0; look < EX_LOOKS && EX_LOAD(p->active) != 0; look++) EX_PAUSE();
   if (EX_LOAD(p->active) != 0) {
      ex_lock(&p->lock);
      while (EX_LOAD(p->active) != 0) ex_wait(&p->done, &p->lock);
      ex_unlock(&p->lock);
   }
   ex_unlock(&p->busy);
}

ex_pool *ex_pool_create(unsigned threads)
{
   ex_pool *p = (ex_pool *)calloc(1, sizeof *p);
   if (!p) return NULL;
   p->threads = threads ? threads : 1;
   p->worker = (ex_worker *)calloc(p->threads, sizeof *p->worker);
   p->ready = ex_mutex_create(&p->busy);
   p->ready += p->ready == 1 && ex_mutex_create(&p->lock);
   p->ready += p->ready == 2 && ex_condition_create(&p->wake);
   p->ready += p->ready == 3 && ex_condition_create(&p->done);
   while (p->ready == 4 && p->worker && p->started + 1 < p->threads) {
      ex_worker *w = &p->worker[p->started];
      w->pool = p;
      w->number = p->started + 1;
      if (!ex_thread_create(&w->thread, ex_worker_main, w)) break;
      p->started++;
   }
   if (p->ready == 4 && p->worker && p->started + 1 == p->threads) return p;
   ex_pool_free(p);
   return NULL;
}

void ex_pool_free(ex_pool *p)
{
   unsigned i;
   if (!p) return;
   if (p->started > 0) {
      EX_STORE(p->stop, 1u);
      ex_announce(p);
   }
   for (i = 0; i < p->started; i++) ex_thread_join(p->worker[i].thread);
   if (p->ready > 3) ex_condition_free(&p->done);
   if (p->ready > 2) ex_condition_free(&p->wake);
   if (p->ready > 1) ex_mutex_free(&p->lock);
   if (p->ready > 0) ex_mutex_free(&p->busy);
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
