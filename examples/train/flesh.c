/*  flesh.c - the training target: where flesh would be, by offline elastic simulation

    shows     what the network learns; nothing here can run in a game (about a second a pose)
    not here  dynamics: every pose is solved on its own, at rest; garments as separate meshes
    build     make flesh
    run       ./flesh --character C.glb --motion A.glb --from 0 --to 100 --step 2 --out T.safetensors
    flow      character --flesh_rest, _lattice, _bones, _solve, _surface--> body, once
              motion --ex_pose--> palettes --flesh_solve, several threads--> vertices, figures, a row each
    out       vertices [F,V,3] F32 model space, the file's vertex order and unit; palettes [F,S,3,4] F32
              frames [F] I32 numbers in the motion; settled [F] I32 1: use it
              volume_change [F] F32 of the flesh, relative; crossings_before, crossings_after [F] I32 vertices of
              the skinned and of the solved mesh that pass through it elsewhere (not counting those at rest);
              stretch_max [F] F32 longest edge against rest; last_step_mm [F] F32; iterations [F] I32; seconds [F] F32
    settled   the last step moved no lattice node by more than --bar. Measured on 8 poses of a range of motion (a body,
              a suit) against the same poses taken to 0.05 mm: after a last step of 0.2 to 0.4 mm the surface is off
              by 0.02 to 0.14 mm in the mean and 0.2 to 1.2 mm at 99 %; after 1.5 mm by 0.14 and 2.3; after 5 mm by
              0.57 and 6.0. Hence 0.5
    repeats   the result does not depend on the number of threads: frames are solved in chains of --chain, each
              from plain skinning, and a chain is one thread's work */
#include "flesh.h"
#include <pthread.h>
#include <stdarg.h>
#include <time.h>
#include <unistd.h>

void flesh_die(const char *format, ...)
{
   va_list list;
   fputs("flesh: ", stderr);
   va_start(list, format);
   vfprintf(stderr, format, list);
   va_end(list);
   fputc('\n', stderr);
   exit(1);
}
void *flesh_zalloc(size_t count, size_t size)
{
   void *p = calloc(count ? count : 1, size);
   if (!p) flesh_die("out of memory");
   return p;
}
void *flesh_grow(void *list, size_t count, size_t size)
{
   void *p = count > SIZE_MAX / size ? NULL : realloc(list, count * size);
   if (!p) flesh_die("out of memory");
   return p;
}
static double now(void)
{
   struct timespec t;
   clock_gettime(CLOCK_MONOTONIC, &t);
   return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* ------------------------------------------------- options */
static flesh_options options = {0.02, 0.46, 0.035, 4, 0.5, 6, 0.002, 0.35, 10, 0.001, 10, 40000, 64, 8, 240, 3, 12, 1, 1, 0.5, 0};
static const char *character, *motion_path, *clip, *out_path;
static int from = 0, to = 0, step = 1, threads = 0;

typedef struct option { const char *name; double *real; int *whole; const char **text; double lo, hi; const char *help; } option;
static const option table[] = {
   {"character", 0, 0, &character, 0, 0, "skinned mesh, .glb .gltf or .safetensors"},
   {"motion", 0, 0, &motion_path, 0, 0, "animation, .glb .gltf, or .safetensors with palettes"},
   {"clip", 0, 0, &clip, 0, 0, "name or number of the animation in that file; default the first"},
   {"out", 0, 0, &out_path, 0, 0, "the truth, .safetensors"},
   {"from", 0, &from, 0, 0, 1e9, "first frame"},
   {"to", 0, &to, 0, 0, 1e9, "frame to stop before; 0: the end"},
   {"step", 0, &step, 0, 1, 1e9, "every how many frames"},
   {"threads", 0, &threads, 0, 0, 256, "0: one for each core"},
   {"cell", &options.cell, 0, 0, 1e-4, 1, "lattice cell, m"},
   {"nu", &options.nu, 0, 0, 0, 0.4999, "Poisson's ratio"},
   {"self", &options.self, 0, 0, 0, 1, "flesh within this distance along the body does not touch itself, m"},
   {"bone", &options.bone, 0, 0, 0, 1e6, "stiffness of bones, in cell edges"},
   {"bonerad", &options.bonerad, 0, 0, 1e-3, 1, "bones end at this fraction of the way to the skin"},
   {"rigid", &options.rigid, 0, 0, 0, 1e6, "stiffness of hands, head, feet"},
   {"tether", &options.tether, 0, 0, 1e-9, 1e6, "stiffness towards plain skinning everywhere"},
   {"hourglass", &options.hourglass, 0, 0, 1e-6, 1e3, "stiffness against zig-zag in cells"},
   {"contact", &options.contact, 0, 0, 0, 1e6, "stiffness of contact; 0: none"},
   {"thick", &options.thick, 0, 0, 0, 1, "distance that touching skin keeps, m"},
   {"w", &options.w, 0, 0, 1e-3, 1e6, "elastic weight in the solver's first guess of the Hessian"},
   {"cells", 0, &options.cells, 0, 100, 1000000, "where about more would be needed, cells are larger"},
   {"iters", 0, &options.iters, 0, 1, 100000, "most iterations a pose"},
   {"refresh", 0, &options.refresh, 0, 1, 100000, "iterations between searches for contact"},
   {"frozen", 0, &options.frozen, 0, 0, 100000, "further iterations with the contacts held, if unsettled"},
   {"mush", 0, &options.mush, 0, 0, 1000, "smoothing passes that hide the cells"},
   {"memory", 0, &options.memory, 0, 1, 64, "pairs that L-BFGS keeps"},
   {"chain", 0, &options.chain, 0, 1, 100000, "frames that start from one another"},
   {"names", 0, &options.names, 0, 0, 1, "0: ignore joint names, find ends and limbs by shape"},
   {"bar", &options.bar, 0, 0, 0, 1e6, "a pose is settled when its last step is at most this, mm"},
   {"verbose", 0, &options.verbose, 0, 0, 3, "1 poses, 2 iterations"}
};
static void usage(void)
{
   size_t i;
   fputs("usage: flesh --character C --motion A --out T.safetensors [--from a] [--to b] [--step k] ...\n", stderr);
   for (i = 0; i < sizeof table / sizeof *table; i++) {
      const option *o = &table[i];
      fprintf(stderr, "  --%-10s %s", o->name, o->help);
      if (o->real) fprintf(stderr, " (%g)", *o->real);
      if (o->whole) fprintf(stderr, " (%d)", *o->whole);
      fputc('\n', stderr);
   }
   exit(2);
}
static void parse(int argc, char **argv)
{
   int i;
   for (i = 1; i < argc; i += 2) {
      const option *o = NULL;
      size_t k;
      for (k = 0; k < sizeof table / sizeof *table; k++) if (!strncmp(argv[i], "--", 2) && !strcmp(argv[i] + 2, table[k].name)) o = &table[k];
      if (!o) { fprintf(stderr, "flesh: unknown option %s\n", argv[i]); usage(); }
      if (i + 1 == argc) flesh_die("%s needs a value", argv[i]);
      if (o->text) *o->text = argv[i + 1];
      else {
         char *end;
         double v = strtod(argv[i + 1], &end);
         if (*end || end == argv[i + 1] || !(v >= o->lo && v <= o->hi)) flesh_die("%s %s: expected a number from %g to %g", argv[i], argv[i + 1], o->lo, o->hi);
         if (o->real) *o->real = v;
         else *o->whole = (int)v;
      }
   }
   if (!character || !motion_path || !out_path) usage();
}

/* ------------------------------------------------- the work, shared by the threads */
typedef struct job {
   pthread_mutex_t lock;
   const body *b;
   const ex_motion *motion;
   ex_writer *w;
   size_t id[11];
   int count, next, done;    /* poses; first pose not yet taken; poses written */
   double start;
   int tty, shown;
   figures sum;              /* sums over the settled poses */
   int unsettled, worst_stretch_frame;
   float worst_stretch, worst_volume;
   double after_all, before_all;
} job;

static void progress(job *j)
{
   double spent = now() - j->start, left = spent / j->done * (j->count - j->done);
   int tenth = 10 * j->done / j->count;
   if (j->tty) fprintf(stderr, "\r%d of %d poses, %d not settled, %.1f s a pose, %.0f min %02.0f s left   ", j->done, j->count, j->unsettled, spent / j->done, floor(left / 60), fmod(left, 60));
   else if (tenth > j->shown) fprintf(stderr, "%d of %d poses, %d not settled, %.1f s a pose, %.0f min %02.0f s left\n", j->done, j->count, j->unsettled, spent / j->done, floor(left / 60), fmod(left, 60));
   j->shown = tenth;
   if (j->tty && j->done == j->count) fputc('\n', stderr);
}
static void store(job *j, int k, int frame, const float *vertices, const float *palette, const figures *f)
{
   size_t V = j->b->scene->vertices, S = j->b->scene->joints, i = (size_t)k;
   int32_t n[5];
   float x[4];
   n[0] = frame; n[1] = f->settled; n[2] = f->crossings_before; n[3] = f->crossings_after; n[4] = f->iterations;
   x[0] = f->volume; x[1] = f->stretch; x[2] = f->step_mm; x[3] = (float)f->seconds;
   pthread_mutex_lock(&j->lock);
   ex_writer_put(j->w, j->id[0], 3 * V * i, vertices, 3 * V);
   ex_writer_put(j->w, j->id[1], 12 * S * i, palette, 12 * S);
   ex_writer_put(j->w, j->id[2], i, &n[0], 1);
   ex_writer_put(j->w, j->id[3], i, &n[1], 1);
   ex_writer_put(j->w, j->id[4], i, &x[0], 1);
   ex_writer_put(j->w, j->id[5], i, &n[2], 1);
   ex_writer_put(j->w, j->id[6], i, &n[3], 1);
   ex_writer_put(j->w, j->id[7], i, &x[1], 1);
   ex_writer_put(j->w, j->id[8], i, &x[2], 1);
   ex_writer_put(j->w, j->id[9], i, &n[4], 1);
   ex_writer_put(j->w, j->id[10], i, &x[3], 1);
   j->done++;
   j->unsettled += !f->settled;
   if (f->settled) {
      j->before_all += f->crossings_before;
      j->after_all += f->crossings_after;
      if (fabsf(f->volume) > fabsf(j->worst_volume)) j->worst_volume = f->volume;
      if (f->stretch > j->worst_stretch || (f->stretch == j->worst_stretch && frame < j->worst_stretch_frame)) { j->worst_stretch = f->stretch; j->worst_stretch_frame = frame; }
   }
   if (options.verbose) fprintf(stderr, "frame %d: %.2f s, %d iterations, %d evaluations, last step %.3f mm, %d contacts, deepest %.1f mm, volume %+.2f %%, crossings %d -> %d, stretch %.2f%s\n",
                                frame, f->seconds, f->iterations, f->evaluations, (double)f->step_mm, f->contacts, (double)f->deepest_mm, 100 * (double)f->volume, f->crossings_before, f->crossings_after, (double)f->stretch, f->settled ? "" : ", NOT SETTLED");
   else progress(j);
   pthread_mutex_unlock(&j->lock);
}
static void *work(void *user)
{
   job *j = (job *)user;
   solver *s = flesh_solver(j->b);
   float *vertices = NEW(float, 3 * j->b->scene->vertices), *palette = NEW(float, 12 * j->b->scene->joints);
   for (;;) {
      int k, first, last;
      pthread_mutex_lock(&j->lock);
      first = j->next;
      j->next = last = first + options.chain < j->count ? first + options.chain : j->count;
      pthread_mutex_unlock(&j->lock);
      if (first >= last) break;
      for (k = first; k < last; k++) {
         figures f;
         int frame = from + k * step;
         ex_pose(j->b->scene, j->motion, (size_t)frame, palette);
         flesh_solve(s, palette, k == first, vertices, &f);
         store(j, k, frame, vertices, palette, &f);
      }
   }
   free(vertices);
   free(palette);
   flesh_solver_free(s);
   return NULL;
}
static void declare(job *j)
{
   static const char *const name[11] = {"vertices", "palettes", "frames", "settled", "volume_change", "crossings_before", "crossings_after", "stretch_max", "last_step_mm", "iterations", "seconds"};
   static const ex_dtype type[11] = {EX_F32, EX_F32, EX_I32, EX_I32, EX_F32, EX_I32, EX_I32, EX_F32, EX_F32, EX_I32, EX_F32};
   size_t shape[4], i;
   const char *c = strrchr(character, '/'), *m = strrchr(motion_path, '/');
   ex_writer_meta(j->w, "source", "flesh");
   ex_writer_meta(j->w, "character", c ? c + 1 : character);
   ex_writer_meta(j->w, "motion", m ? m + 1 : motion_path);
   ex_writer_meta(j->w, "clip", j->motion->name);
   ex_writer_metaf(j->w, "fps", "%g", (double)j->motion->fps / step);
   for (i = 0; i < sizeof table / sizeof *table; i++) {
      if (table[i].real) ex_writer_metaf(j->w, table[i].name, "%g", *table[i].real);
      if (table[i].whole && table[i].whole != &threads && table[i].whole != &options.verbose) ex_writer_metaf(j->w, table[i].name, "%d", *table[i].whole);
   }
   for (i = 0; i < 11; i++) {
      shape[0] = (size_t)j->count;
      shape[1] = i ? j->b->scene->joints : j->b->scene->vertices;
      shape[2] = 3;
      shape[3] = 4;
      j->id[i] = ex_writer_tensor(j->w, name[i], type[i], i == 0 ? 3 : i == 1 ? 4 : 1, shape);
   }
}
int main(int argc, char **argv)
{
   char error[EX_ERROR];
   ex_scene *scene;
   ex_motion *motion = NULL;
   body *b = NEW(body, 1);
   pthread_t thread[256];
   job j;
   double t0 = now(), settled;
   int i;
   parse(argc, argv);
   if (!(scene = ex_scene_load(character, error)) || !(motion = ex_motion_load(motion_path, clip, scene, error))) flesh_die("%s", error);
   if (to <= 0 || to > (int)motion->frames) to = (int)motion->frames;
   if (from >= to) flesh_die("%s has %d frames, none from %d to %d", motion_path, (int)motion->frames, from, to);
   b->o = options;
   flesh_rest(b, scene);
   flesh_lattice(b);
   flesh_bones(b);
   flesh_system(b);
   flesh_contacts(b);
   flesh_surface(b);
   memset(&j, 0, sizeof j);
   j.b = b;
   j.motion = motion;
   j.count = (to - from + step - 1) / step;
   j.tty = isatty(2);
   if (threads <= 0) threads = (int)sysconf(_SC_NPROCESSORS_ONLN);
   if (threads > 256) threads = 256;
   if (threads > (j.count + options.chain - 1) / options.chain) threads = (j.count + options.chain - 1) / options.chain;
   if (threads < 1) threads = 1;
   fprintf(stderr, "%s: %d vertices, %d after welding, %d cells, %d nodes, factor %.0f MB, set up in %.1f s; %d poses on %d threads\n",
           character, (int)scene->vertices, b->vertices, b->cells, b->nodes, (double)b->row[b->nodes] * 4e-6, now() - t0, j.count, threads);
   if (!(j.w = ex_writer_open(out_path, error))) flesh_die("%s", error);
   declare(&j);
   pthread_mutex_init(&j.lock, NULL);
   j.start = now();
   for (i = 1; i < threads; i++) if (pthread_create(&thread[i], NULL, work, &j)) threads = i;
   work(&j);
   for (i = 1; i < threads; i++) pthread_join(thread[i], NULL);
   if (!ex_writer_close(j.w, error)) flesh_die("%s", error);
   settled = j.count - j.unsettled;
   printf("%d poses in %.1f s, %d not settled (last step over %g mm; marked in the file)\n", j.count, now() - j.start, j.unsettled, options.bar);
   if (settled > 0)
      printf("settled poses: volume change at most %+.2f %%, crossing vertices %.1f skinned -> %.1f solved on average, largest edge stretch %.2f (frame %d)\n",
             100 * (double)j.worst_volume, j.before_all / settled, j.after_all / settled, (double)j.worst_stretch, j.worst_stretch_frame);
   ex_motion_free(motion); /* the body goes with the process */
   ex_scene_free(scene);
   return 0;
}
