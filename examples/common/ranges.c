/* ranges.c - see ranges.h */
#include "ranges.h"
#include "tool.h"
#include "tensors.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ===================================================================================== >>histograms
   Bin i of a channel holds the numbers in [i w, (i + 1) w); w is a power of two, so that when the channel outgrows its
   bins, two of them make one of twice the width and nothing is counted twice. Bin i stands at i modulo BINS. */
enum { BINS = 2048, NAME_ROOM = 80 };

typedef struct ex__channel {
   double width;              /* w; 0: nothing seen */
   int64_t first, last;       /* bins in use, at most BINS */
   float least, most;         /* seen */
   uint32_t count[BINS];
} ex__channel;
typedef struct ex__output {       /* of one block */
   char name[NAME_ROOM];      /* "dense.0.3.range" */
   size_t width;
   ex__channel *channels;
   float *range;              /* (2,width) */
   int kept;
} ex__output;
struct ex_ranges {
   ex__output *outputs;
   size_t count, room, latest; /* latest: where the last tap went; the next one mostly belongs behind it */
   size_t kept;
   int failed;
   ex_ranges_report report;
};

static size_t slot(int64_t bin) { return (size_t)((uint64_t)bin % BINS); }
static int64_t bin_of(const ex__channel *c, float x) { return (int64_t)floor((double)x / c->width); }

static void widen(ex__channel *c, float least, float most)
{
   if (c->width == 0) {
      double span = (double)most - (double)least, largest = fmax(fabs((double)least), fabs((double)most));
      int exponent;
      frexp(fmax(fmax(span / (BINS / 2), largest * 1e-6), 1e-30), &exponent); /* 1e-6: bins of large numbers stay countable */
      c->width = ldexp(1, exponent);
      c->least = least, c->most = most;
      c->first = bin_of(c, least), c->last = bin_of(c, most);
   }
   c->least = least < c->least ? least : c->least;
   c->most = most > c->most ? most : c->most;
   while (bin_of(c, c->most) - bin_of(c, c->least) >= BINS) {
      uint32_t merged[BINS];
      int64_t i, half;
      memset(merged, 0, sizeof merged);
      for (i = c->first; i <= c->last; i++) {
         half = i >= 0 ? i / 2 : -((1 - i) / 2); /* rounded down */
         merged[slot(half)] += c->count[slot(i)];
      }
      memcpy(c->count, merged, sizeof merged);
      c->first = c->first >= 0 ? c->first / 2 : -((1 - c->first) / 2);
      c->last = c->last >= 0 ? c->last / 2 : -((1 - c->last) / 2);
      c->width *= 2;
   }
   c->first = bin_of(c, c->least), c->last = bin_of(c, c->most);
}
static int is_finite(float x)
{
   uint32_t u;
   memcpy(&u, &x, 4);
   return (u >> 23 & 255) != 255;
}
static void count_column(ex__channel *c, const float *x, size_t count, size_t stride)
{
   float least = 0, most = 0;
   size_t i, any = 0;
   for (i = 0; i < count; i++) {
      float v = x[i * stride];
      if (!is_finite(v)) continue;
      if (!any || v < least) least = v;
      if (!any || v > most) most = v;
      any = 1;
   }
   if (!any) return;
   widen(c, least, most);
   for (i = 0; i < count; i++)
      if (is_finite(x[i * stride])) c->count[slot(bin_of(c, x[i * stride]))]++;
}

/* ===================================================================================== >>collecting */
static int wanted(const char *name) /* by its last part, "dir.post.0" like "post.0"; the parser is one row for all nodes */
{
   const char *last = name, *s;
   for (s = name; (s = strchr(s, '.')) != NULL; s++)
      if (s[1] >= 'a' && s[1] <= 'z') last = s + 1;
   return strcmp(last, "features") != 0 && strcmp(last, "out") != 0 && strncmp(last, "parser.", 7) != 0 &&
          strlen(name) + sizeof ".range" <= NAME_ROOM;
}
static ex__output *find(ex_ranges *r, const char *name, size_t width)
{
   char full[NAME_ROOM];
   size_t k, i;
   ex__output *o;
   snprintf(full, sizeof full, "%s.range", name);
   for (k = 0; k < r->count; k++) {
      i = (r->latest + k) % r->count;
      if (strcmp(r->outputs[i].name, full) != 0) continue;
      r->latest = i;
      return r->outputs[i].width == width ? &r->outputs[i] : NULL;
   }
   if (r->count == r->room) {
      o = (ex__output *)realloc(r->outputs, (2 * r->room + 32) * sizeof *o);
      if (!o) return NULL;
      r->outputs = o;
      r->room = 2 * r->room + 32;
   }
   o = &r->outputs[r->count];
   memset(o, 0, sizeof *o);
   memcpy(o->name, full, sizeof full);
   o->width = width;
   o->channels = (ex__channel *)ex_take(width, sizeof *o->channels);
   o->range = (float *)ex_take(width, 2 * sizeof *o->range);
   if (!o->channels || !o->range) {
      free(o->channels);
      free(o->range);
      return NULL;
   }
   r->latest = r->count++;
   return o;
}
static void tap(void *user, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t row_stride)
{
   ex_ranges *r = (ex_ranges *)user;
   ex__output *o;
   size_t c;
   (void)first;
   if (!wanted(name)) return;
   o = find(r, name, width);
   if (!o) r->failed = 1;
   else
      for (c = 0; c < width; c++) count_column(&o->channels[c], rows + c, count, row_stride);
}
ex_ranges *ex_ranges_create(void) { return (ex_ranges *)ex_take(1, sizeof(ex_ranges)); }
void ex_ranges_free(ex_ranges *r)
{
   size_t k;
   if (!r) return;
   for (k = 0; k < r->count; k++) free(r->outputs[k].channels), free(r->outputs[k].range);
   free(r->outputs);
   free(r);
}
dn_probe ex_ranges_probe(ex_ranges *r)
{
   dn_probe p;
   memset(&p, 0, sizeof p);
   p.tap = tap;
   p.user = r;
   return p;
}

/* ===================================================================================== >>choosing
   In units of a bin, ends at the edges a < b of bins 0 .. n - 1, numbers at their bins' centres:
       error(a, b) = N ((b - a) / 254)^2 / 12 + sum_{x < a} (a - x)^2 + sum_{x > b} (x - b)^2
   Convex in (a, b): the best a for a b, then the best b for that a, until neither moves. */
typedef struct sums { double n, x, xx; } sums; /* of the numbers up to an edge: how many, their sum, the sum of squares */
static double beyond(sums s, double edge) { return edge * edge * s.n - 2 * edge * s.x + s.xx; }

static void choose(ex__channel *c, int clip, float *least, float *most, ex_ranges_report *report)
{
   sums up[BINS + 1]; /* to each edge from the left */
   size_t n = c->width > 0 ? (size_t)(c->last - c->first) + 1 : 0, a = 0, b = n, k, old_a, old_b;
   double total;
   up[0].n = up[0].x = up[0].xx = 0;
   for (k = 0; k < n; k++) {
      double count = c->count[slot(c->first + (int64_t)k)], x = (double)k + 0.5;
      up[k + 1].n = up[k].n + count, up[k + 1].x = up[k].x + count * x, up[k + 1].xx = up[k].xx + count * x * x;
   }
   total = up[n].n;
   do {
      double best = -1, error;
      old_a = a, old_b = b;
      for (k = 0; clip && k < b; k++) {
         error = total * (double)((b - k) * (b - k)) / (254.0 * 254.0 * 12.0) + beyond(up[k], (double)k);
         if (best < 0 || error < best) best = error, a = k;
      }
      for (best = -1, k = n; clip && k > a; k--) {
         sums over;
         over.n = up[n].n - up[k].n, over.x = up[n].x - up[k].x, over.xx = up[n].xx - up[k].xx;
         error = total * (double)((k - a) * (k - a)) / (254.0 * 254.0 * 12.0) + beyond(over, (double)k);
         if (best < 0 || error < best) best = error, b = k;
      }
   } while (a != old_a || b != old_b);
   *least = a == 0 ? c->least : (float)((double)(c->first + (int64_t)a) * c->width);
   *most = b == n ? c->most : (float)((double)(c->first + (int64_t)b) * c->width);
   if (!(*most - *least > 1e-6f * (fabsf(*least) + fabsf(*most)))) { /* a channel that never changes: a step that is not 0 */
      float half = 1e-3f * (fabsf(*least) + 1e-3f);
      *least -= half, *most += half;
   }
   report->numbers += total;
   report->outside += total - (up[b].n - up[a].n);
   report->channels++;
   report->clipped += a > 0 || b < n;
}
int ex_ranges_choose(ex_ranges *r, int clip)
{
   size_t k, c, other;
   memset(&r->report, 0, sizeof r->report);
   r->kept = 0;
   for (k = 0; k < r->count; k++) {
      ex__output *o = &r->outputs[k];
      unsigned long number;
      char next[NAME_ROOM];
      o->kept = 1;
      if (sscanf(o->name, "pre.%lu.range", &number) == 1) {
         snprintf(next, sizeof next, "pre.%lu.range", number + 1);
         for (other = 0; other < r->count; other++) o->kept &= strcmp(r->outputs[other].name, next) != 0;
      }
      if (!o->kept) continue;
      r->kept++;
      for (c = 0; c < o->width; c++) choose(&o->channels[c], clip, &o->range[c], &o->range[o->width + c], &r->report);
   }
   return !r->failed;
}
static const ex__output *kept(const ex_ranges *r, size_t k)
{
   size_t i;
   for (i = 0; i < r->count; i++)
      if (r->outputs[i].kept && k-- == 0) return &r->outputs[i];
   return NULL;
}
const float *ex_ranges_at(const ex_ranges *r, size_t k, const char **name, size_t *width)
{
   const ex__output *o = kept(r, k);
   if (!o) return NULL;
   *name = o->name;
   *width = o->width;
   return o->range;
}
ex_ranges_report ex_ranges_describe(const ex_ranges *r) { return r->report; }

/* ===================================================================================== >>joining
   A safetensors file is 8 bytes of header length, a JSON object, and the tensors' bytes. New tensors are named before the
   object's closing brace and follow the old bytes: nothing that was there moves or changes. A range that the file has
   already is written over where it stands. */
static void put_floats(unsigned char *to, const float *x, size_t count) /* little-endian */
{
   size_t i;
   for (i = 0; i < count; i++) {
      uint32_t u;
      memcpy(&u, x + i, 4);
      to[4 * i] = (unsigned char)u, to[4 * i + 1] = (unsigned char)(u >> 8), to[4 * i + 2] = (unsigned char)(u >> 16),
      to[4 * i + 3] = (unsigned char)(u >> 24);
   }
}
/* old: the tensors of `file`, checked. NULL and a line in why when a range is there in another shape */
static unsigned char *join(const ex_ranges *r, const unsigned char *file, size_t size, const dn_tensors *old, size_t *joined, char *why)
{
   size_t head = 0, end, rest, room, data = 0, k, at;
   unsigned char *out;
   char *text;
   const ex__output *o;
   for (k = 8; k-- > 0;) head = head << 8 | file[k];
   rest = size - 8 - head;
   for (end = 8 + head; end > 8 && file[end - 1] != '}';) end--; /* spaces may follow it */
   end--;                                                         /* where new entries go */
   for (k = 0, room = 8; (o = kept(r, k)) != NULL; k++) room += NAME_ROOM + 128, data += 8 * o->width;
   out = (unsigned char *)malloc(size + room + data);
   if (!out) {
      snprintf(why, EX_ERROR, "out of memory");
      return NULL;
   }
   memcpy(out, file, end);
   text = (char *)out + end;
   for (k = 0, at = rest; (o = kept(r, k)) != NULL; k++) {
      const dn_tensor *t = dn_tensors_find(old, o->name);
      if (t && (t->format != DN_ST_F32 || t->rank != 2 || t->shape[0] != 2 || t->shape[1] != o->width)) {
         snprintf(why, EX_ERROR, "%s is there already, but not as F32 (2,%lu)", o->name, (unsigned long)o->width);
         free(out);
         return NULL;
      }
      if (t) continue;
      text += sprintf(text, "%s\"%s\":{\"dtype\":\"F32\",\"shape\":[2,%lu],\"data_offsets\":[%lu,%lu]}", text[-1] == '{' ? "" : ",", o->name,
                      (unsigned long)o->width, (unsigned long)at, (unsigned long)(at + 8 * o->width));
      at += 8 * o->width;
   }
   *text++ = '}';
   while ((text - (char *)out) % 8) *text++ = ' ';
   head = (size_t)(text - (char *)out) - 8;
   for (k = 0; k < 8; k++) out[k] = (unsigned char)((uint64_t)head >> 8 * k);
   memcpy(text, file + size - rest, rest);
   for (k = 0, at = rest; (o = kept(r, k)) != NULL; k++) {
      const dn_tensor *t = dn_tensors_find(old, o->name);
      put_floats((unsigned char *)text + (t ? (size_t)(t->data - (file + size - rest)) : at), o->range, 2 * o->width);
      if (!t) at += 8 * o->width;
   }
   *joined = 8 + head + at;
   return out;
}
static unsigned char *join_checked(const ex_ranges *r, const void *file, size_t size, size_t *joined, char *why)
{
   size_t bytes;
   void *memory = NULL;
   dn_tensors *old = NULL;
   dn_error e;
   unsigned char *out = NULL;
   if (dn_tensors_size(file, size, &bytes, &e) != DN_OK) snprintf(why, EX_ERROR, "%s", e.info);
   else if (!(memory = malloc(bytes))) snprintf(why, EX_ERROR, "out of memory");
   else if (dn_tensors_open(file, size, memory, bytes, &old, &e) != DN_OK) snprintf(why, EX_ERROR, "%s", e.info);
   else out = join(r, (const unsigned char *)file, size, old, joined, why);
   free(memory);
   return out;
}
unsigned char *ex_ranges_join(const ex_ranges *r, const void *file, size_t size, size_t *joined)
{
   char why[EX_ERROR];
   return join_checked(r, file, size, joined, why);
}
int ex_ranges_save(const ex_ranges *r, const char *path, const char *out, char *error)
{
   FILE *f = fopen(path, "rb");
   unsigned char *file = NULL, *all = NULL;
   char *part = (char *)malloc(strlen(out) + 6), why[EX_ERROR];
   long size = -1;
   size_t joined = 0;
   int good = 0;
   if (f && fseek(f, 0, SEEK_END) == 0) size = ftell(f);
   if (size > 0 && fseek(f, 0, SEEK_SET) == 0) file = (unsigned char *)malloc((size_t)size);
   if (!part || !file || fread(file, 1, (size_t)size, f) != (size_t)size) ex_fail(error, path, "cannot be read");
   else if (!(all = join_checked(r, file, (size_t)size, &joined, why))) ex_fail(error, path, "%s", why);
   else {
      FILE *to;
      strcpy(part, out);
      strcat(part, ".part");
      to = fopen(part, "wb");
      good = to && fwrite(all, 1, joined, to) == joined;
      if (to && fclose(to) != 0) good = 0;
      if (good) remove(out); /* rename does not replace a file everywhere */
      good = good && rename(part, out) == 0;
      if (!good) {
         remove(part);
         ex_fail(error, out, "cannot be written");
      }
   }
   if (f) fclose(f);
   free(file);
   free(all);
   free(part);
   return good;
}
