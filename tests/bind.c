/*  bind.c - binding asks its progress callback often, on the caller's thread only, and stops at every place where it asks

    shows   weld, graph and voxels ask inside their loops; a cancelled bind gives everything back; asking changes nothing;
            heaps of vertices on one place, where welding compares pair by pair
    build   cc -O2 bind.c -o bind -lm -lpthread */
#define _POSIX_C_SOURCE 200809L
#define DN__TICK ((size_t)512) /* asks more often than in earnest, so that a small mesh shows it */
#define DEFORMNET_IMPLEMENTATION
#define DEFORMNET_STATIC
#include "../deformnet.h"
#include "test.h"
#include <math.h>
#include <pthread.h>

enum { ROWS = 50, COLUMNS = 60, V = ROWS * COLUMNS, T = 2 * (ROWS - 1) * COLUMNS, S = 3 };
typedef struct tube { /* open at both ends */
   float positions[V * 3], weights[V * 2], joints_at[S * 12];
   uint32_t joints[V * 2], indices[T * 3];
   dn_skin_set skin;
   dn_rig_desc desc;
} tube;
static tube b0;

static void tube_make(tube *b)
{
   size_t i, j, t = 0, k;
   memset(b, 0, sizeof *b);
   for (i = 0; i < ROWS; i++)
      for (j = 0; j < COLUMNS; j++) {
         size_t v = i * COLUMNS + j;
         double a = 6.283185307179586 * (double)j / COLUMNS, x = (double)i / (ROWS - 1);
         b->positions[3 * v] = (float)x;
         b->positions[3 * v + 1] = (float)(0.2 * cos(a));
         b->positions[3 * v + 2] = (float)(0.2 * sin(a));
         b->joints[2 * v] = i < ROWS / 2 ? 0 : 1, b->joints[2 * v + 1] = i < ROWS / 2 ? 1 : 2;
         b->weights[2 * v] = 0.75f, b->weights[2 * v + 1] = 0.25f;
         if (i + 1 < ROWS)
            for (k = 0; k < 2; k++, t++) {
               size_t right = i * COLUMNS + (j + 1) % COLUMNS;
               b->indices[3 * t] = (uint32_t)(k ? right : v);
               b->indices[3 * t + 1] = (uint32_t)(k ? right + COLUMNS : right);
               b->indices[3 * t + 2] = (uint32_t)(v + COLUMNS);
            }
      }
   for (k = 0; k < S; k++) {
      float *m = b->joints_at + 12 * k;
      m[0] = m[5] = m[10] = 1;
      m[3] = -0.25f - 0.25f * (float)k;
   }
   b->skin.influences = 2, b->skin.joints = b->joints, b->skin.joint_type = DN_U32;
   b->skin.weights = b->weights, b->skin.weight_type = DN_F32;
   b->desc.mesh.vertices = V, b->desc.mesh.positions = b->positions, b->desc.mesh.triangles = T;
   b->desc.mesh.indices = b->indices, b->desc.mesh.index_type = DN_U32, b->desc.mesh.skin_sets = 1, b->desc.mesh.skin = &b->skin;
   b->desc.skeleton.joints = S, b->desc.skeleton.inverse_bind = b->joints_at;
   b->desc.resolution = 40;
}

/* --- a callback that counts, and stops at the `left`th time of a stage */
typedef struct watch {
   const char *stop_in; /* NULL: never */
   size_t left, asked, after, weld, graph, wrong_thread, wrong_done;
   int stopped;
   pthread_t thread;
   char stage[32];
   float done;
} watch;
static int watch_step(void *user, const char *stage, float done)
{
   watch *w = (watch *)user;
   w->asked++;
   w->after += (size_t)w->stopped;
   w->wrong_thread += !pthread_equal(w->thread, pthread_self());
   w->weld += strcmp(stage, "weld") == 0;
   w->graph += strcmp(stage, "graph") == 0;
   if (strcmp(stage, w->stage) != 0) w->done = 0;
   w->wrong_done += !(done >= w->done && done <= 1.0f);
   w->done = done;
   snprintf(w->stage, sizeof w->stage, "%s", stage);
   if (w->stop_in && strcmp(stage, w->stop_in) == 0 && w->left-- == 0) w->stopped = 1;
   return w->stopped;
}
static watch watch_of(const char *stop_in, size_t left, dn_progress *p)
{
   watch w;
   memset(&w, 0, sizeof w);
   w.stop_in = stop_in, w.left = left, w.thread = pthread_self();
   p->step = watch_step;
   return w;
}

/* --- an allocator that counts what lives */
static void *counted_alloc(void *user, size_t size, size_t align)
{
   (void)align;
   ++*(size_t *)user;
   return test_aligned(size);
}
static void counted_free(void *user, void *p, size_t size)
{
   (void)size;
   --*(size_t *)user;
   test_aligned_free(p);
}
static uint64_t rig_hash(const dn_rig *rig)
{
   dn_rig_view v;
   uint64_t h = 14695981039346656037u;
   dn_rig_describe(rig, &v);
   h = test_hash(h, v.node_of_vertex, v.vertices * sizeof(uint32_t));
   h = test_hash(h, v.graph.first, (v.nodes + 1) * sizeof(uint32_t));
   return test_hash(h, v.graph.next, v.graph.first[v.nodes] * sizeof(uint32_t));
}

TEST(weld_and_graph_stop_wherever_they_ask)
{
   static const char *const stages[] = { "weld", "graph" };
   size_t stage, cases = 0, live = 0, heap;
   dn_allocator al;
   al.alloc = counted_alloc, al.free = counted_free, al.user = &live;
   for (heap = 0; heap < 2; heap++) {
      dn_progress p;
      watch w;
      dn_error e;
      dn_rig *rig;
      uint64_t plain, asked;
      size_t k, total;
      tube_make(&b0);
      if (heap) /* all of one row in one place with weights that do not match: each compares itself with those before */
         for (k = 0; k < COLUMNS; k++) {
            memcpy(b0.positions + 3 * k, b0.positions, 3 * sizeof(float));
            b0.weights[2 * k] = (float)k / COLUMNS, b0.weights[2 * k + 1] = 1 - (float)k / COLUMNS;
         }
      rig = dn_rig_create(NULL, &b0.desc, &al, NULL, &e);
      if (!CHECK(rig != NULL)) return;
      plain = rig_hash(rig);
      dn_rig_free(rig);
      w = watch_of(NULL, 0, &p);
      p.user = &w;
      b0.desc.progress = &p;
      rig = dn_rig_create(NULL, &b0.desc, &al, NULL, &e);
      if (!CHECK(rig != NULL)) return;
      asked = rig_hash(rig);
      dn_rig_free(rig);
      CHECK(plain == asked && w.wrong_done == 0 && w.wrong_thread == 0);
      CHECK_MSG(w.weld >= V / 512 && w.graph >= T / 512, "weld asked %lu times, graph %lu", (unsigned long)w.weld, (unsigned long)w.graph);
      for (stage = 0; stage < 2; stage++) {
         total = stage ? w.graph : w.weld;
         for (k = 0; k < total; k++, cases++) {
            watch one = watch_of(stages[stage], k, &p);
            p.user = &one;
            memset(&e, 0, sizeof e);
            rig = dn_rig_create(NULL, &b0.desc, &al, NULL, &e);
            CHECK(!rig && e.code == DN_CANCELLED && e.info[0]);
            CHECK_MSG(one.stopped && one.after == 0 && live == 0, "%s, step %lu", stages[stage], (unsigned long)k);
         }
      }
   }
   AT_LEAST(cases, 40, "places");
}

/* --- a hook with real threads: nobody but the caller's may call back */
typedef struct share { dn_range_fn *fn; void *job; size_t begin, end; unsigned worker; } share;
static void *share_main(void *user)
{
   share *s = (share *)user;
   s->fn(s->job, s->begin, s->end, s->worker);
   return NULL;
}
static void spread(void *user, size_t count, size_t grain, dn_range_fn *fn, void *job)
{
   pthread_t thread[3];
   share s[3];
   size_t units = (count + grain - 1) / grain, at = 0, k, started = 0;
   (void)user;
   for (k = 0; k < 3; k++) {
      size_t end = (k + 1) * units / 3 * grain;
      s[k].fn = fn, s[k].job = job, s[k].worker = (unsigned)k, s[k].begin = at, s[k].end = end < count ? end : count;
      at = s[k].end;
      if (s[k].begin == s[k].end) continue;
      if (pthread_create(&thread[started], NULL, share_main, &s[k])) exit(2);
      started++;
   }
   for (k = 0; k < started; k++) pthread_join(thread[k], NULL);
}
TEST(geodesic_asks_on_the_calling_thread)
{
   dn_parallel par;
   dn_progress p;
   watch w;
   float *distance[2], joints[3 * S];
   size_t scratch_bytes, k, stopped = 0;
   unsigned threads;
   void *scratch;
   tube_make(&b0);
   memset(&par, 0, sizeof par);
   for (k = 0; k < S; k++) joints[3 * k] = 0.25f + 0.25f * (float)k, joints[3 * k + 1] = joints[3 * k + 2] = 0;
   for (threads = 1; threads <= 3; threads += 2) {
      par.run = threads > 1 ? spread : NULL, par.workers = threads;
      scratch_bytes = dn_geodesic_scratch(b0.positions, V, T, 40, threads);
      scratch = test_aligned(scratch_bytes);
      distance[threads > 1] = (float *)test_block(V * S * sizeof(float));
      w = watch_of(NULL, 0, &p);
      p.user = &w;
      CHECK(dn_geodesic(b0.positions, V, b0.indices, T, joints, S, 40, distance[threads > 1], NULL, NULL, scratch, scratch_bytes, &par, &p) == DN_OK);
      CHECK_MSG(w.wrong_thread == 0 && w.wrong_done == 0 && w.asked > 20, "asked %lu times", (unsigned long)w.asked);
      for (k = 0; k < w.asked; k++, stopped++) {
         watch one = watch_of("geodesic", k, &p);
         p.user = &one;
         CHECK(dn_geodesic(b0.positions, V, b0.indices, T, joints, S, 40, distance[threads > 1], NULL, NULL, scratch, scratch_bytes, &par, &p) == DN_CANCELLED);
         CHECK(one.stopped && one.after == 0 && one.wrong_thread == 0);
      }
      test_aligned_free(scratch);
   }
   CHECK(memcmp(distance[0], distance[1], V * S * sizeof(float)) == 0);
   free(distance[0]);
   free(distance[1]);
   AT_LEAST(stopped, 40, "places");
}

int main(int argc, char **argv)
{
   TEST_BEGIN(argc, argv);
   RUN(weld_and_graph_stop_wherever_they_ask);
   RUN(geodesic_asks_on_the_calling_thread);
   return TEST_END();
}
