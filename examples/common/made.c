/* made.c - see made.h */
#include "made.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint32_t ex_random(uint64_t *state)
{
   *state = *state * 6364136223846793005u + 1442695040888963407u;
   return (uint32_t)(*state >> 33);
}
static double ex_between(uint64_t *state, double low, double high)
{
   return low + (high - low) * (double)ex_random(state) / 2147483648.0;
}

/* ===================================================================================== >>file
   Tensors are named in the header and filled in the data at once: both grow. */
typedef struct maker {
   char *header;
   float *data;
   size_t header_used, header_room, data_used, data_room; /* bytes; floats */
   uint64_t seed;
   int failed;
} maker;

static void put(maker *m, const char *format, ...)
{
   va_list list;
   int n;
   if (m->failed) return;
   if (m->header_used + 4096 > m->header_room) {
      char *more = (char *)realloc(m->header, m->header_room = 2 * m->header_room + 8192);
      if (!more) {
         m->failed = 1;
         return;
      }
      m->header = more;
   }
   va_start(list, format);
   n = vsnprintf(m->header + m->header_used, m->header_room - m->header_used, format, list);
   va_end(list);
   if (n < 0 || (size_t)n >= m->header_room - m->header_used) m->failed = 1;
   else m->header_used += (size_t)n;
}
/* a tensor of uniform numbers in middle - spread .. middle + spread; columns 0: one side only */
static void tensor(maker *m, const char *name, const char *part, size_t rows, size_t columns, double middle, double spread)
{
   size_t count = rows * (columns ? columns : 1), i;
   while (!m->failed && m->data_used + count > m->data_room) {
      float *more = (float *)realloc(m->data, (m->data_room = 2 * m->data_room + 65536) * sizeof(float));
      if (!more) m->failed = 1;
      else m->data = more;
   }
   if (m->failed) return;
   put(m, ",\"%s%s\":{\"dtype\":\"F32\",\"shape\":[%lu", name, part, (unsigned long)rows);
   if (columns) put(m, ",%lu", (unsigned long)columns);
   put(m, "],\"data_offsets\":[%lu,%lu]}", (unsigned long)(4 * m->data_used), (unsigned long)(4 * (m->data_used + count)));
   for (i = 0; i < count; i++) m->data[m->data_used++] = (float)(middle + ex_between(&m->seed, -spread, spread));
}
static unsigned char *finish(maker *m, size_t *size)
{
   unsigned char *file = NULL;
   size_t k, length;
   put(m, "}");
   while (!m->failed && m->header_used % 8) put(m, " ");
   length = m->header_used;
   *size = 8 + length + 4 * m->data_used;
   if (!m->failed) file = (unsigned char *)malloc(*size);
   if (file) {
      const unsigned short probe = 1;
      for (k = 0; k < 8; k++) file[k] = (unsigned char)(k < 4 ? length >> 8 * k : 0);
      memcpy(file + 8, m->header, length);
      memcpy(file + 8 + length, m->data, 4 * m->data_used);
      for (k = 8 + length; *(const unsigned char *)&probe == 0 && k < *size; k += 4) { /* the file is little-endian */
         unsigned char swap[4];
         memcpy(swap, file + k, 4);
         file[k] = swap[3], file[k + 1] = swap[2], file[k + 2] = swap[1], file[k + 3] = swap[0];
      }
   }
   free(m->header);
   free(m->data);
   return file;
}

/* ===================================================================================== >>networks
   gain: the standard deviation that a layer gives its output when its input has one, before the activation */
static size_t linear(maker *m, const char *name, size_t in, size_t out, double gain)
{
   tensor(m, name, ".weight", out, in, 0, gain * sqrt(3.0 / (double)in));
   tensor(m, name, ".bias", out, 0, 0, 0.1);
   return out;
}
static size_t gat(maker *m, const char *name, size_t in, size_t heads, size_t features, size_t self, double gain)
{
   tensor(m, name, ".lin.weight", heads * features, in, 0, gain * sqrt(3.0 / (double)in));
   tensor(m, name, ".att_dst", heads, features, 0, 0.3);
   tensor(m, name, ".att_src", heads, features, 0, 0.3);
   if (self) tensor(m, name, ".self.weight", self, in, 0, gain * sqrt(3.0 / (double)in));
   return heads * features + self;
}
static void pool(maker *m, const char *name, size_t in, size_t features)
{
   tensor(m, name, ".lin.weight", features, in, 0, sqrt(3.0 / (double)in));
   tensor(m, name, ".att_dst", 1, features, 0, 0.5);
   tensor(m, name, ".att_src", 1, features, 0, 0.5);
}
static const char *named(char *buffer, size_t size, const char *format, ...)
{
   va_list list;
   va_start(list, format);
   vsnprintf(buffer, size, format, list);
   va_end(list);
   return buffer;
}
#define NAME(...) named(name, sizeof name, __VA_ARGS__)

static void scales(maker *m, const char *prefix, size_t width)
{
   char name[64];
   tensor(m, NAME("%sinput.mean", prefix), "", width, 0, 0, 0.1);
   tensor(m, NAME("%sinput.std", prefix), "", width, 0, 0.5, 0.05);
   tensor(m, NAME("%soutput.mean", prefix), "", 3, 0, 0, 1e-4);
   tensor(m, NAME("%soutput.std", prefix), "", 3, 0, 0.01, 1e-3);
}
static void tail(maker *m, const char *prefix, size_t in, size_t first, size_t second, size_t out)
{
   char name[64];
   in = linear(m, NAME("%spost.0", prefix), in, first, 1);
   in = linear(m, NAME("%spost.1", prefix), in, second, 1);
   linear(m, NAME("%sout", prefix), in, out, 0.3);
}
static void densegats(maker *m, size_t width)
{
   size_t module, block, in;
   char name[64];
   in = linear(m, "pre.0", width, 32, 1);
   in = linear(m, "pre.1", in, 32, 1.5);
   for (module = 0; module < 3; module++) {
      for (block = 0; block < 6; block++) in += gat(m, NAME("dense.%lu.%lu", (unsigned long)module, (unsigned long)block), in, 8, 8, 8, 2);
      if (module < 2) in = gat(m, NAME("transition.%lu", (unsigned long)module), in, 8, 8, 8, 2);
   }
   tail(m, "", in, 512, 128, 3);
}
static void multiresgnet(maker *m, size_t width)
{
   size_t in = linear(m, "pre.0", width, 64, 1), local;
   in = linear(m, "pre.1", in, 32, 1.5);
   local = in + gat(m, "local.0", in, 8, 16, 128, 2);
   local += gat(m, "local.1", local, 8, 16, 128, 2);
   pool(m, "pool", in, 16);
   in = gat(m, "global.0", in, 8, 16, 128, 2);
   in = gat(m, "global.1", in, 8, 16, 128, 2);
   in = gat(m, "global.2", in, 8, 16, 128, 2);
   tail(m, "", local + in, 256, 64, 3);
}
static void clothnet(maker *m, size_t coarse_width, size_t detail_width)
{
   static const char *const coarse[] = { "coarse.dir.", "coarse.len." }, *const detail[] = { "detail.dir.", "detail.len." };
   size_t k, in, first;
   char name[64];
   first = gat(m, "coarse.gat", coarse_width, 4, 32, 128, 1);
   for (k = 0; k < 2; k++) {
      in = gat(m, NAME("%sgat.0", coarse[k]), first, 4, 64, 256, 1);
      in = gat(m, NAME("%sgat.1", coarse[k]), in, 4, 64, 256, 1);
      in = gat(m, NAME("%sgat.2", coarse[k]), in, 4, 32, 128, 1);
      tail(m, coarse[k], in, 256, 128, k ? 1 : 3);
   }
   in = linear(m, "parser.0", 85, 256, 1);
   in = linear(m, "parser.1", in, 512, 1.4);
   linear(m, "parser.2", in, 1024, 1.4);
   first = gat(m, "detail.gat", detail_width, 4, 128, 512, 1);
   for (k = 0; k < 2; k++) {
      in = gat(m, NAME("%sgat.0", detail[k]), first, 4, 32, 128, 1.4);
      pool(m, NAME("%spool", detail[k]), in, 32);
      in = gat(m, NAME("%sgat.1", detail[k]), in, 4, 32, 128, 1);
      in = gat(m, NAME("%sgat.2", detail[k]), in, 4, 16, 64, 1);
      in = gat(m, NAME("%sgat.3", detail[k]), in, 4, 12, 48, 1);
      tail(m, detail[k], in, 128, 64, k ? 1 : 3);
   }
}

unsigned char *ex_made_model(const char *arch, const char *pooling, size_t joints, size_t *size)
{
   const int cloth = strcmp(arch, "clothnet") == 0, position = strcmp(arch, "multiresgnet") != 0;
   size_t width = 6 + joints, k;
   maker m;
   memset(&m, 0, sizeof m);
   m.seed = 1;
   put(&m, "{\"__metadata__\":{\"deformnet.version\":\"1\",\"deformnet.arch\":\"%s\",\"deformnet.features\":\"%s\",", arch,
       cloth ? "normal,relative,fit:1" : position ? "position,normal,geodesic" : "relative,normal,geodesic");
   if (cloth) put(&m, "\"deformnet.features.detail\":\"normal,relative,distance\",");
   put(&m, "\"deformnet.frame\":\"model\",\"deformnet.pooling\":\"%s\",\"deformnet.unit\":\"1\",\"deformnet.joints\":\"", pooling);
   for (k = 0; k < joints; k++) put(&m, "%sjoint%lu", k ? "," : "", (unsigned long)k);
   put(&m, "\",\"deformnet.licence\":\"MIT or public domain\",\"deformnet.trained_on\":\"nothing: random weights for measuring\"}");
   if (strcmp(arch, "densegats") == 0) densegats(&m, width);
   else if (strcmp(arch, "multiresgnet") == 0) multiresgnet(&m, width);
   else if (cloth) clothnet(&m, 7, width);
   else if (strcmp(arch, "mlp") == 0) {
      k = linear(&m, "pre.0", width, 256, 1);
      k = linear(&m, "pre.1", k, 512, 1.5);
      k = linear(&m, "pre.2", k, 512, 1.5);
      k = linear(&m, "pre.3", k, 128, 1.5);
      linear(&m, "out", k, 3, 0.3);
   } else if (strcmp(arch, "gat") == 0) {
      k = gat(&m, "gat.0", width, 4, 64, 0, 1);
      k = gat(&m, "gat.1", k, 4, 64, 0, 1.5);
      k = gat(&m, "gat.2", k, 4, 64, 0, 1.5);
      k = gat(&m, "gat.3", k, 4, 32, 0, 1.5);
      linear(&m, "out", k, 3, 0.3);
   } else if (strcmp(arch, "neuroskinning") == 0) {
      k = linear(&m, "pre.0", width, 128, 1);
      k = linear(&m, "pre.1", k, 128, 1.5);
      k = gat(&m, "gat.0", k, 8, 32, 0, 1.5);
      k = gat(&m, "gat.1", k, 8, 32, 0, 1.5);
      k = gat(&m, "gat.2", k, 8, 32, 0, 1.5);
      k = linear(&m, "post.0", k, 256, 1.5);
      k = linear(&m, "post.1", k, 128, 1.5);
      linear(&m, "out", k, 3, 0.3);
   } else m.failed = 1;
   if (cloth) scales(&m, "coarse.", 7), scales(&m, "detail.", width);
   else scales(&m, "", width);
   return finish(&m, size);
}

/* ===================================================================================== >>mesh */
static void *take(size_t count, size_t size) { return count > SIZE_MAX / size ? NULL : calloc(count ? count : 1, size); }

void ex_made_free(ex_made *m)
{
   if (!m) return;
   free(m->positions);
   free(m->triangle);
   free(m->skin_joints);
   free(m->skin_weights);
   free(m->inverse_bind);
   free(m->palette);
   free(m->geodesic);
   free(m);
}
static void joint_at(size_t s, size_t joints, double p[3])
{
   double a = 6.283185307179586 * (double)s / (double)joints;
   p[0] = 0.5 * cos(a), p[1] = 0.0, p[2] = 0.5 * sin(a);
}
static void pose_joint(size_t joints, size_t s, uint64_t *seed, float *palette, float *inverse_bind)
{
   double p[3], axis[3], r[9], length = 0, angle = ex_between(seed, 0.1, 0.5), c = cos(angle), n = sin(angle);
   size_t i, j;
   joint_at(s, joints, p);
   for (i = 0; i < 3; i++) axis[i] = ex_between(seed, -1, 1), length += axis[i] * axis[i];
   for (i = 0; i < 3; i++) axis[i] /= sqrt(length + 1e-9);
   for (i = 0; i < 3; i++)
      for (j = 0; j < 3; j++) {
         double cross = i == j ? 0 : (i + 1) % 3 == j ? -axis[3 - i - j] : axis[3 - i - j];
         r[3 * i + j] = (i == j ? c : 0) + n * cross + (1 - c) * axis[i] * axis[j];
      }
   for (i = 0; i < 3; i++) {
      float *to = palette + 12 * s + 4 * i, *bind = inverse_bind ? inverse_bind + 12 * s + 4 * i : NULL;
      for (j = 0; j < 3; j++) to[j] = (float)r[3 * i + j];
      to[3] = (float)(p[i] - r[3 * i] * p[0] - r[3 * i + 1] * p[1] - r[3 * i + 2] * p[2]);
      for (j = 0; bind && j < 4; j++) bind[j] = j < 3 ? (float)(i == j) : (float)-p[i];
   }
}
void ex_made_pose(const ex_made *m, unsigned number, float *palette)
{
   uint64_t seed = 1000003u + number;
   size_t s;
   for (s = 0; s < m->joints; s++) pose_joint(m->joints, s, &seed, palette, NULL);
}
ex_made *ex_made_mesh(size_t vertices, size_t joints, double thick, int shuffle)
{
   ex_made *m = (ex_made *)take(1, sizeof *m);
   size_t i, j, k, v;
   uint32_t *place;
   uint64_t seed = 7;
   if (!m) return NULL;
   m->around = (size_t)(sqrt((double)vertices / (thick < 1 ? thick : 1)) + 0.5);
   m->around = m->around < 4 ? 4 : m->around;
   m->about = (vertices + m->around / 2) / m->around;
   m->about = m->about < 3 ? 3 : m->about;
   m->vertices = m->around * m->about, m->triangles = 2 * m->vertices, m->joints = joints;
   m->positions = (float *)take(m->vertices, 3 * sizeof(float));
   m->triangle = (uint32_t *)take(m->triangles, 3 * sizeof(uint32_t));
   m->skin_joints = (uint32_t *)take(m->vertices, 4 * sizeof(uint32_t));
   m->skin_weights = (float *)take(m->vertices, 4 * sizeof(float));
   m->inverse_bind = (float *)take(joints, 12 * sizeof(float));
   m->palette = (float *)take(joints, 12 * sizeof(float));
   m->geodesic = (float *)take(m->vertices, joints * sizeof(float));
   place = (uint32_t *)take(m->vertices, sizeof(uint32_t));
   if (!m->positions || !m->triangle || !m->skin_joints || !m->skin_weights || !m->inverse_bind || !m->palette || !m->geodesic || !place) {
      free(place);
      ex_made_free(m);
      return NULL;
   }
   for (v = 0; v < m->vertices; v++) place[v] = (uint32_t)v;
   for (v = m->vertices - 1; shuffle && v > 0; v--) {
      uint32_t other = (uint32_t)(((uint64_t)ex_random(&seed) * (v + 1)) >> 31), swap = place[v];
      place[v] = place[other], place[other] = swap;
   }
   for (k = 0; k < joints; k++) pose_joint(joints, k, &seed, m->palette, m->inverse_bind);
   for (i = 0; i < m->around; i++)
      for (j = 0; j < m->about; j++) {
         size_t right = (i + 1) % m->around * m->about, up = (j + 1) % m->about;
         const size_t corner[6] = { i * m->about + j, right + up, right + j, i * m->about + j, i * m->about + up, right + up };
         double a = 6.283185307179586 * (double)i / (double)m->around, b = 6.283185307179586 * (double)j / (double)m->about;
         double r = 0.5 + 0.5 * thick * cos(b) * (1 + 0.1 * sin(9 * a)), at = (double)i / (double)m->around * (double)joints, sum = 0;
         v = place[corner[0]];
         m->positions[3 * v] = (float)(r * cos(a));
         m->positions[3 * v + 1] = (float)(0.5 * thick * sin(b));
         m->positions[3 * v + 2] = (float)(r * sin(a));
         for (k = 0; k < 4; k++) { /* the four joints around it, the nearer the heavier */
            double w = 2.5 - fabs((double)k - 1 - (at - floor(at)));
            m->skin_joints[4 * v + k] = (uint32_t)(((size_t)at + joints + k - 1) % joints);
            m->skin_weights[4 * v + k] = (float)(w * w);
            sum += w * w;
         }
         for (k = 0; k < 4; k++) m->skin_weights[4 * v + k] = (float)((double)m->skin_weights[4 * v + k] / sum);
         for (k = 0; k < 6; k++) m->triangle[6 * (i * m->about + j) + k] = place[corner[k]];
         for (k = 0; k < joints; k++) {
            double p[3], d = 0;
            size_t c;
            joint_at(k, joints, p);
            for (c = 0; c < 3; c++) d += ((double)m->positions[3 * v + c] - p[c]) * ((double)m->positions[3 * v + c] - p[c]);
            m->geodesic[joints * v + k] = (float)sqrt(d);
         }
      }
   free(place);
   return m;
}
