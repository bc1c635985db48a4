/* tool.c - see tool.h */
#include "tool.h"
#include "scene.h"
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const char *ex_name = "example";

void ex_program(const char *name) { ex_name = name; }
static void ex_line(const char *format, va_list list)
{
   fprintf(stderr, "%s: ", ex_name);
   vfprintf(stderr, format, list);
   fputc('\n', stderr);
}
int ex_say(const char *format, ...)
{
   va_list list;
   va_start(list, format);
   ex_line(format, list);
   va_end(list);
   return 1;
}
int ex_say_error(const char *file, const dn_error *e)
{
   return ex_say("%s: %s: %s (%s)", file, e->where ? e->where : "deformnet", dn_result_text(e->code), e->info);
}
void ex_die(const char *format, ...)
{
   va_list list;
   va_start(list, format);
   ex_line(format, list);
   va_end(list);
   exit(1);
}

void *ex_take(size_t count, size_t size)
{
   return size && count > SIZE_MAX / size ? NULL : calloc(count ? count : 1, size ? size : 1);
}
double ex_now_ms(void)
{
   struct timespec t;
   clock_gettime(CLOCK_MONOTONIC, &t);
   return (double)t.tv_sec * 1e3 + (double)t.tv_nsec * 1e-6;
}
static int ex_by_double(const void *a, const void *b)
{
   double x = *(const double *)a, y = *(const double *)b;
   return (x > y) - (x < y);
}
double ex_median(double *x, size_t n)
{
   if (n == 0) return 0;
   qsort(x, n, sizeof *x, ex_by_double);
   return n % 2 ? x[n / 2] : (x[n / 2 - 1] + x[n / 2]) / 2;
}
int ex_ends_with(const char *s, const char *end)
{
   size_t n = strlen(s), m = strlen(end);
   return n >= m && strcmp(s + n - m, end) == 0;
}
int ex_read_whole(const char *s, long low, long high, long *value)
{
   char *end;
   errno = 0;
   *value = strtol(s, &end, 10);
   return end != s && !*end && errno == 0 && *value >= low && *value <= high;
}
int ex_precision_named(const char *name)
{
   int p = DN_PRECISION_COUNT;
   while (--p >= 0 && strcmp(name, dn_precision_name((dn_precision)p)) != 0) {}
   return p;
}
unsigned ex_processors(void)
{
   long n = sysconf(_SC_NPROCESSORS_ONLN);
   return n < 1 ? 1 : n > 8 ? 8 : (unsigned)n;
}
const char *ex_bundled(const char *program, const char *name, char *path, size_t size)
{
   const char *slash = strrchr(program, '/');
   const char *found = NULL;
   int k;
   for (k = 0; k < 3 && !found; k++) {
      if (k == 0) snprintf(path, size, "%s", name);
      else if (k == 1) snprintf(path, size, "examples/%s", name);
      else if (slash) snprintf(path, size, "%.*s/%s", (int)(slash - program), program, name);
      if (access(path, R_OK) == 0) found = path;
   }
   if (!found) snprintf(path, size, "%s", name); /* opening it gives the error */
   return path;
}

void ex_describe(const ex_scene *s, dn_rig_desc *d, dn_skin_set *skin)
{
   memset(d, 0, sizeof *d);
   memset(skin, 0, sizeof *skin);
   skin->influences = s->influences;
   skin->joints = s->skin_joints;
   skin->joint_type = DN_U32;
   skin->weights = s->skin_weights;
   skin->weight_type = DN_F32;
   d->mesh.vertices = s->vertices;
   d->mesh.positions = s->positions;
   d->mesh.triangles = s->triangles;
   d->mesh.indices = s->triangle;
   d->mesh.index_type = DN_U32;
   d->mesh.skin_sets = 1;
   d->mesh.skin = skin;
   d->skeleton.joints = s->joints;
   d->skeleton.names = (const char *const *)s->names;
   d->skeleton.parents = s->parents;
   d->skeleton.inverse_bind = s->inverse_bind;
   d->skeleton.matrix = DN_3X4_ROWS;
   d->order = DN_ORDER_NEAR; /* results stand by vertex all the same */
}
