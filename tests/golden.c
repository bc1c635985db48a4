/*  golden.c - runs golden files: known inputs, known outputs, every intermediate tensor between them
    shows     the product path: load the model, bind the character, run the stages, compare what each block wrote
    usage     golden FILE...                         model and cases in one file: golden.CASE.in.NAME ...
              golden --model M.safetensors CASE...   the model from M; a case file without case names works too:
                                                     golden.in.NAME, golden.mid.NAME, golden.out.NAME
              --tolerance X    the absolute part of 1e-5 + 1e-4 |x|
              --kernel NAME    reference, sse, avx2, avx512, neon or wasm in place of the fastest one here
              --every-kernel   each one that this machine runs in turn
              --brief          a line per case, and the failures
    prints    a line per tensor: PASS, FAIL or SKIP, the largest error, and that error as a share of the tolerance;
              last "golden: N passed, N failed"; the exit code is 1 when one failed or nothing was compared
    ties      dynamic pooling may contract other pairs where two scores tie within rounding (networks.md, section 7).
              Only when the outputs differ are the scores looked at: see >ties below. What is excused is printed */
#define _POSIX_C_SOURCE 200809L
#define DN_MAX_DIM ((size_t)1 << 28) /* golden tensors have a row per attention edge: longer than any model's side */
#define DEFORMNET_IMPLEMENTATION
#include "../deformnet.h"
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#define COUNT(a) (sizeof(a) / sizeof *(a))

static dn_model_options options; /* DN_KERNEL_AUTO: what packing chooses */
static int brief;       /* a line per case, and the failures */
static double case_share;
static double absolute = 1e-5;
static const double relative = 1e-4;
static size_t passed, failed, skipped, excused_total;

/* --- memory and files ------------------------------------------------------------------------------------- */
static void *need(size_t count, size_t unit)
{
   void *p = unit && count > SIZE_MAX / 2 / unit ? NULL : calloc(count ? count : 1, unit);
   if (!p) fprintf(stderr, "golden: out of memory for %zu x %zu bytes\n", count, unit), exit(2);
   return p;
}
static void *block64(size_t bytes, void **raw) /* 64-byte aligned; free *raw */
{
   unsigned char *p = (unsigned char *)need(bytes + 64, 1);
   *raw = p;
   return p + (64 - ((uintptr_t)p & 63));
}

typedef struct bytes { unsigned char *data; size_t size; } bytes;

static bytes read_file(const char *path)
{
   bytes b = {NULL, 0};
   FILE *f = fopen(path, "rb");
   size_t capacity = 0, n;
   if (!f) return b;
   do {
      if (b.size == capacity) {
         unsigned char *more;
         capacity = capacity ? capacity * 2 : (size_t)1 << 20;
         more = (unsigned char *)realloc(b.data, capacity);
         if (!more) fprintf(stderr, "golden: out of memory for %s\n", path), exit(2);
         b.data = more;
      }
      n = fread(b.data + b.size, 1, capacity - b.size, f);
      b.size += n;
   } while (n);
   fclose(f);
   return b;
}

typedef struct file { bytes b; void *memory; dn_tensors *t; } file;

static int open_bytes(file *f, bytes b, const char *path)
{
   dn_error err;
   size_t size;
   memset(f, 0, sizeof *f);
   f->b = b;
   if (dn_tensors_size(b.data, b.size, &size, &err) != DN_OK) goto bad;
   f->memory = need(size + 16, 1);
   if (dn_tensors_open(b.data, b.size, f->memory, size, &f->t, &err) != DN_OK) goto bad;
   return 1;
bad:
   printf("FAIL %s: %s\n", path, err.info);
   return 0;
}
static void close_file(file *f)
{
   free(f->memory);
   free(f->b.data);
}

/* --- the header of a safetensors file as text: set one string of "__metadata__" ---------------------------- */
static size_t skip_space(const char *s, size_t i, size_t n)
{
   while (i < n && (s[i] == ' ' || s[i] == '\n' || s[i] == '\t' || s[i] == '\r')) i++;
   return i;
}
static size_t skip_string(const char *s, size_t i, size_t n) /* at the opening quote; past the closing one */
{
   for (i++; i < n && s[i] != '"'; i++)
      if (s[i] == '\\') i++;
   return i < n ? i + 1 : n;
}
static size_t skip_value(const char *s, size_t i, size_t n) /* a string, or a bracketed value, or a plain word */
{
   size_t depth = 0;
   do {
      if (i >= n) return n;
      if (s[i] == '"') i = skip_string(s, i, n);
      else {
         if (s[i] == '{' || s[i] == '[') depth++;
         if (s[i] == '}' || s[i] == ']') depth--;
         i++;
      }
   } while (depth || (i < n && s[i] != ',' && s[i] != '}' && s[i] != ']'));
   return i;
}
/* the span of the value of `key` in the object that opens at s[i]; 0 when it has none */
static int find_value(const char *s, size_t i, size_t n, const char *key, size_t *from, size_t *to)
{
   size_t length = strlen(key);
   i = skip_space(s, i + 1, n);
   while (i < n && s[i] == '"') {
      size_t name = i + 1, end = skip_string(s, i, n);
      i = skip_space(s, end, n);
      if (i >= n || s[i] != ':') return 0;
      *from = skip_space(s, i + 1, n);
      *to = skip_value(s, *from, n);
      if (end - 1 - name == length && memcmp(s + name, key, length) == 0) return 1;
      i = skip_space(s, *to, n);
      if (i < n && s[i] == ',') i = skip_space(s, i + 1, n);
   }
   return 0;
}
static bytes set_meta(bytes in, const char *key, const char *value) /* a new file; value needs no escapes */
{
   bytes out = {NULL, 0};
   const char *s = (const char *)in.data + 8;
   size_t n = 0, open, object, end, from, to, k, header, pad, added;
   char *text, *at;
   for (k = 0; k < 8; k++) n |= (size_t)in.data[k] << (8 * k);
   open = skip_space(s, 0, n);
   added = strlen(key) + strlen(value) + 32;
   text = (char *)need(n + added + 32, 1);
   if (!find_value(s, open, n, "__metadata__", &object, &end)) { /* none: put one first */
      size_t next = skip_space(s, open + 1, n);
      memcpy(text, s, open + 1);
      at = text + open + 1;
      at += sprintf(at, "\"__metadata__\":{\"%s\":\"%s\"}%s", key, value, s[next] == '}' ? "" : ",");
      from = to = open + 1;
   } else if (find_value(s, object, n, key, &from, &to)) {
      memcpy(text, s, from);
      at = text + from;
      at += sprintf(at, "\"%s\"", value);
   } else {
      size_t next = skip_space(s, object + 1, n);
      from = to = object + 1;
      memcpy(text, s, from);
      at = text + from;
      at += sprintf(at, "\"%s\":\"%s\"%s", key, value, s[next] == '}' ? "" : ",");
   }
   memcpy(at, s + to, n - to);
   header = (size_t)(at - text) + (n - to);
   pad = (8 - header % 8) % 8;
   memset(text + header, ' ', pad);
   header += pad;
   out.size = 8 + header + (in.size - 8 - n);
   out.data = (unsigned char *)need(out.size, 1);
   for (k = 0; k < 8; k++) out.data[k] = (unsigned char)((uint64_t)header >> (8 * k));
   memcpy(out.data + 8, text, header);
   memcpy(out.data + 8 + header, in.data + 8 + n, in.size - 8 - n);
   free(text);
   return out;
}

/* --- one case -------------------------------------------------------------------------------------------- */
typedef struct run {
   const file *model, *cases; /* the same file unless --model was given */
   const char *name;          /* of the case; "" when the names carry none */
   unsigned char *done;       /* per tensor of the case file: compared, or skipped with a reason */
} run;

static char *joined(const char *a, const char *b, const char *c, const char *d)
{
   char *s = (char *)need(strlen(a) + strlen(b) + strlen(c) + strlen(d) + 1, 1);
   strcat(strcat(strcat(strcpy(s, a), b), c), d);
   return s;
}
static const dn_tensor *find(const file *f, const char *a, const char *b, const char *c, const char *d)
{
   char *name = joined(a, b, c, d);
   const dn_tensor *t = dn_tensors_find(f->t, name);
   free(name);
   return t;
}
static const dn_tensor *in(const run *r, const char *kind_and_name) /* "in.positions", "out.y", "mid.pre.0" */
{
   return find(r->cases, "golden.", r->name, *r->name ? "." : "", kind_and_name);
}
static size_t dim(const dn_tensor *t, unsigned axis) { return t && axis < t->rank ? t->shape[axis] : 1; }
static float *floats(const dn_tensor *t)
{
   float *x = (float *)need(t->count, sizeof *x);
   dn_tensor_floats(t, 0, t->count, x);
   return x;
}
static int32_t *ints(const dn_tensor *t)
{
   int32_t *x = (int32_t *)need(t->count, sizeof *x);
   if (t->format == DN_ST_I32) dn_tensor_ints(t, 0, t->count, x);
   else { /* some writers keep indices as floats */
      float *f = floats(t);
      size_t i;
      for (i = 0; i < t->count; i++) x[i] = (int32_t)f[i];
      free(f);
   }
   return x;
}
static uint32_t *indices(const dn_tensor *t) { return (uint32_t *)ints(t); }

static void mark(const run *r, const dn_tensor *t)
{
   size_t i, n = dn_tensors_count(r->cases->t);
   for (i = 0; i < n; i++)
      if (dn_tensors_at(r->cases->t, i) == t) r->done[i] = 1;
}
static const char *short_name(const run *r, const dn_tensor *t)
{
   return t->name + strlen("golden.") + (*r->name ? strlen(r->name) + 1 : 0);
}
static void line(const run *r, const char *verdict, const char *what, const char *form, ...)
{
   va_list args;
   if (*verdict == 'P') passed++;
   else if (*verdict == 'F') failed++;
   else skipped++;
   if (brief && *verdict != 'F') return;
   printf("  %s %-14s %-34s ", verdict, r->name, what);
   va_start(args, form);
   vprintf(form, args);
   va_end(args);
   printf("\n");
}
static int row_agrees(const float *want, const float *got, size_t width)
{
   size_t j;
   for (j = 0; j < width; j++) {
      double w = (double)want[j], g = (double)got[j], e = w > g ? w - g : g - w;
      if (!(e <= absolute + relative * (w < 0 ? -w : w))) return 0;
   }
   return 1;
}
/* what the file holds against rows (count, width) of stride floats. A row r that disagrees is left out, and counted, if
   excused[r]. `part` names a second way to the same tensor. */
static int compare(const run *r, const dn_tensor *t, const char *part, const float *got, size_t count, size_t width,
                   size_t stride, const unsigned char *excused)
{
   double worst = 0, share = 0;
   size_t i, j, at = 0, bad = 0, left_out = 0;
   char *what;
   float *want;
   if (!t) return 1;
   mark(r, t);
   what = joined(short_name(r, t), *part ? " " : "", part, "");
   if (t->count != count * width) {
      line(r, "FAIL", what, "the file has %zu numbers, this program %zu x %zu", t->count, count, width);
      free(what);
      return 0;
   }
   want = floats(t);
   for (i = 0; i < count; i++) {
      if (excused && excused[i] && !row_agrees(want + i * width, got + i * stride, width)) {
         left_out++;
         continue;
      }
      for (j = 0; j < width; j++) {
         double w = (double)want[i * width + j], g = (double)got[i * stride + j], e = w > g ? w - g : g - w;
         double allowed = absolute + relative * (w < 0 ? -w : w);
         if (!(e <= allowed)) bad++; /* catches NaN */
         if (!(e <= worst)) worst = e;
         if (!(e / allowed <= share)) share = e / allowed, at = i * width + j;
      }
   }
   excused_total += left_out;
   if (!(share <= case_share)) case_share = share;
   if (left_out)
      line(r, bad ? "FAIL" : "PASS", what, "largest error %.2e, %.3f of the tolerance; %zu of %zu rows differ near a tie",
           worst, share, left_out, count);
   else if (bad)
      line(r, "FAIL", what, "largest error %.2e, %.3f of the tolerance at %zu,%zu (%.9g, expected %.9g); %zu of %zu too far",
           worst, share, at / width, at % width, (double)got[at / width * stride + at % width], (double)want[at], bad,
           t->count);
   else line(r, "PASS", what, "largest error %.2e, %.3f of the tolerance", worst, share);
   free(want);
   free(what);
   return !bad;
}
static int compare_ints(const run *r, const dn_tensor *t, const uint32_t *got, size_t count)
{
   size_t i, bad = 0, first = 0;
   int32_t *want;
   if (!t) return 1;
   mark(r, t);
   if (t->count != count) {
      line(r, "FAIL", short_name(r, t), "the file has %zu integers, this program %zu", t->count, count);
      return 0;
   }
   want = ints(t);
   for (i = count; i-- > 0;)
      if (want[i] != (int32_t)got[i]) bad++, first = i;
   if (bad)
      line(r, "FAIL", short_name(r, t), "%zu of %zu differ, the first at %zu: %ld, expected %ld", bad, count, first,
           (long)(int32_t)got[first], (long)want[first]);
   else line(r, "PASS", short_name(r, t), "%zu equal", count);
   free(want);
   return !bad;
}

/* edges as sets of (smaller, larger) */
static int by_pair(const void *a, const void *b)
{
   const uint32_t *p = (const uint32_t *)a, *q = (const uint32_t *)b;
   if (p[0] != q[0]) return p[0] < q[0] ? -1 : 1;
   return p[1] < q[1] ? -1 : p[1] > q[1];
}
static void compare_edges(const run *r, const dn_tensor *t, const dn_graph *g)
{
   size_t i, k, n = 0, wanted;
   uint32_t *mine, *want;
   if (!t) return;
   mark(r, t);
   mine = (uint32_t *)need(g->first[g->nodes] + 2, sizeof *mine);
   for (i = 0; i < g->nodes; i++)
      for (k = g->first[i]; k < g->first[i + 1]; k++)
         if (g->next[k] > i) mine[2 * n] = (uint32_t)i, mine[2 * n + 1] = g->next[k], n++;
   want = indices(t);
   wanted = t->count / 2;
   for (i = 0; i < wanted; i++)
      if (want[2 * i] > want[2 * i + 1]) {
         uint32_t swap = want[2 * i];
         want[2 * i] = want[2 * i + 1], want[2 * i + 1] = swap;
      }
   qsort(mine, n, 2 * sizeof *mine, by_pair);
   qsort(want, wanted, 2 * sizeof *want, by_pair);
   if (n == wanted && memcmp(mine, want, n * 2 * sizeof *mine) == 0) line(r, "PASS", short_name(r, t), "%zu equal", n);
   else line(r, "FAIL", short_name(r, t), "%zu edges, expected %zu, or not the same ones", n, wanted);
   free(mine);
   free(want);
}

/* a graph from the file's list of undirected edges: each edge as a triangle with a repeated node */
typedef struct graph { dn_graph g; uint32_t *first, *next; } graph;
static graph graph_of_triangles(const uint32_t *triangle, size_t triangles, size_t nodes)
{
   graph a;
   void *raw, *scratch = block64(dn_graph_scratch(nodes, triangles), &raw);
   a.first = (uint32_t *)need(nodes + 1, sizeof *a.first);
   a.next = (uint32_t *)need(6 * triangles, sizeof *a.next);
   dn_graph_build(triangle, triangles, nodes, a.first, a.next, &a.g, scratch);
   free(raw);
   return a;
}
static graph graph_of_edges(const dn_tensor *edges, size_t nodes)
{
   uint32_t *e = indices(edges), *t = (uint32_t *)need(edges->count / 2 * 3, sizeof *t);
   size_t i, n = edges->count / 2;
   graph a;
   for (i = 0; i < n; i++) {
      if (e[2 * i] >= nodes || e[2 * i + 1] >= nodes)
         fprintf(stderr, "golden: edge %zu (%lu, %lu) outside %zu nodes\n", i, (unsigned long)e[2 * i],
                 (unsigned long)e[2 * i + 1], nodes),
            exit(2);
      t[3 * i] = e[2 * i], t[3 * i + 1] = t[3 * i + 2] = e[2 * i + 1];
   }
   a = graph_of_triangles(t, n, nodes);
   free(e);
   free(t);
   return a;
}
static void graph_free(graph *a)
{
   free(a->first);
   free(a->next);
}

/* --- layers ---------------------------------------------------------------------------------------------- */
/* the tensors' prefix: the case's name, nothing, or whatever stands before the only such suffix in the model */
static char *prefix_of(const run *r, const char *suffix)
{
   size_t i, length = strlen(suffix), found = 0;
   const char *name = NULL;
   char *prefix;
   if (*r->name && find(r->model, r->name, ".", suffix, "")) return joined(r->name, ".", "", "");
   if (find(r->model, suffix, "", "", "")) return joined("", "", "", "");
   for (i = 0; i < dn_tensors_count(r->model->t); i++) {
      const dn_tensor *t = dn_tensors_at(r->model->t, i);
      size_t n = strlen(t->name);
      if (n > length && t->name[n - length - 1] == '.' && strcmp(t->name + n - length, suffix) == 0 &&
          strncmp(t->name, "golden.", 7) != 0)
         found++, name = t->name;
   }
   if (found != 1) return NULL;
   prefix = joined(name, "", "", "");
   prefix[strlen(prefix) - length] = 0;
   return prefix;
}
static float *weight(const run *r, const char *prefix, const char *suffix) /* NULL when absent */
{
   const dn_tensor *t = find(r->model, prefix, suffix, "", "");
   return t ? floats(t) : NULL;
}
typedef struct norm { float *weight, *bias, *mean, *var; dn_batchnorm bn; } norm;
static const dn_batchnorm *norm_of(const run *r, const char *prefix, norm *n)
{
   n->weight = weight(r, prefix, "bn.weight");
   n->bias = weight(r, prefix, "bn.bias");
   n->mean = weight(r, prefix, "bn.running_mean");
   n->var = weight(r, prefix, "bn.running_var");
   n->bn.weight = n->weight, n->bn.bias = n->bias, n->bn.mean = n->mean, n->bn.var = n->var;
   return n->weight && n->bias && n->mean && n->var ? &n->bn : NULL;
}
static void norm_free(norm *n)
{
   free(n->weight);
   free(n->bias);
   free(n->mean);
   free(n->var);
}
static dn_activation activation_of(const run *r, const char *fallback)
{
   static const struct { const char *name; dn_activation value; } names[] = {
      {"tanhshrink", DN_ACT_TANHSHRINK}, {"leakyrelu", DN_ACT_LEAKYRELU}, {"softmax", DN_ACT_SOFTMAX},
      {"tanh", DN_ACT_TANH}, {"relu", DN_ACT_RELU}, {"none", DN_ACT_NONE}};
   char *key = joined("golden.", r->name, *r->name ? "." : "", "activation");
   const char *text = dn_tensors_meta(r->cases->t, key);
   size_t i;
   free(key);
   if (!text) text = fallback;
   for (i = 0; i < COUNT(names); i++) {
      size_t n = strlen(names[i].name);
      if (strncmp(text, names[i].name, n) == 0 && (text[n] == 0 || text[n] == '_')) return names[i].value;
   }
   return DN_ACT_NONE;
}

static dn_kernel chosen(dn_kernel fastest) { return options.kernel == DN_KERNEL_AUTO ? fastest : options.kernel; }

typedef struct gat { dn_gat g; void *raw; } gat;
static int gat_of(const run *r, const char *prefix, dn_activation activation, gat *out)
{
   const dn_tensor *lin = find(r->model, prefix, "lin.weight", "", ""), *dst = find(r->model, prefix, "att_dst", "", "");
   const dn_tensor *self = find(r->model, prefix, "self.weight", "", "");
   float *l, *d, *s, *own;
   norm n;
   const dn_batchnorm *bn;
   void *memory;
   if (!lin || !dst || lin->rank != 2 || dst->rank != 2 || dst->count != lin->shape[0]) return 0;
   l = floats(lin), d = floats(dst), s = weight(r, prefix, "att_src"), own = weight(r, prefix, "self.weight");
   if (!s) {
      free(l);
      free(d);
      free(own);
      return 0;
   }
   bn = norm_of(r, prefix, &n);
   memory = block64(dn_gat_size(lin->shape[1], dst->shape[0], dst->shape[1], self ? self->shape[0] : 0), &out->raw);
   dn_gat_pack(&out->g, lin->shape[1], dst->shape[0], dst->shape[1], self ? self->shape[0] : 0, l, d, s, own, bn,
               activation, memory);
   out->g.kernel = chosen(out->g.kernel);
   norm_free(&n);
   free(l);
   free(d);
   free(s);
   free(own);
   return 1;
}

static int run_linear(const run *r)
{
   const dn_tensor *x = in(r, "in.x"), *y = in(r, "out.y"), *w;
   char *prefix = prefix_of(r, "weight");
   float *rows, *out, *wv, *bias;
   void *raw, *memory;
   dn_linear layer;
   norm n;
   if (!prefix || !(w = find(r->model, prefix, "weight", "", "")) || w->rank != 2 || x->rank != 2 ||
       x->shape[1] != w->shape[1]) {
      line(r, "FAIL", "in.x", "no weight (out,in) that fits it");
      free(prefix);
      return 1;
   }
   rows = floats(x), wv = floats(w), bias = weight(r, prefix, "bias");
   memory = block64(dn_linear_size(w->shape[1], w->shape[0]), &raw);
   dn_linear_pack(&layer, w->shape[1], w->shape[0], wv, bias, norm_of(r, prefix, &n), activation_of(r, r->name), memory);
   layer.kernel = chosen(layer.kernel);
   out = (float *)need(x->shape[0] * w->shape[0], sizeof *out);
   dn_linear_run(&layer, rows, x->shape[1], x->shape[0], out, w->shape[0], NULL);
   compare(r, y, "", out, x->shape[0], w->shape[0], w->shape[0], NULL);
   memset(out, 0xff, x->shape[0] * w->shape[0] * sizeof *out);
   dn_linear_ref(&layer, rows, x->shape[1], x->shape[0], out, w->shape[0]);
   compare(r, y, "(reference)", out, x->shape[0], w->shape[0], w->shape[0], NULL);
   norm_free(&n);
   free(rows);
   free(wv);
   free(bias);
   free(out);
   free(raw);
   free(prefix);
   return 1;
}

static void run_gat(const run *r)
{
   const dn_tensor *x = in(r, "in.x"), *att = in(r, "out.attention"), *pairs = in(r, "out.attention_edges");
   size_t nodes = dim(x, 0), width, i, k, bad = 0;
   char *prefix = prefix_of(r, "lin.weight");
   float *v, *y, *alpha, *wanted;
   void *raw, *scratch;
   graph a;
   gat b;
   if (!prefix || x->rank != 2 || !gat_of(r, prefix, activation_of(r, "none"), &b)) {
      line(r, "FAIL", "in.x", "no lin.weight, att_dst, att_src that fit it");
      free(prefix);
      return;
   }
   if (b.g.in != x->shape[1]) {
      line(r, "FAIL", "in.x", "%zu columns, lin.weight has %zu", x->shape[1], b.g.in);
      free(prefix);
      free(b.raw);
      return;
   }
   a = graph_of_edges(in(r, "in.edges"), nodes);
   width = b.g.heads * b.g.features + b.g.self;
   v = floats(x);
   y = (float *)need(nodes * width, sizeof *y);
   scratch = block64(dn_gat_scratch(&b.g, nodes), &raw);
   dn_gat_run(&b.g, &a.g, v, b.g.in, y, width, scratch, NULL);
   compare(r, in(r, "out.y"), "", y, nodes, width, width, NULL);
   memset(y, 0xff, nodes * width * sizeof *y);
   dn_gat_ref(&b.g, &a.g, v, b.g.in, y, width, scratch);
   compare(r, in(r, "out.y"), "(reference)", y, nodes, width, width, NULL);
   if (att && pairs) { /* rows of the file in the order of its pairs (i,j) */
      uint32_t *e = indices(pairs);
      size_t rows = pairs->count / 2, heads = b.g.heads;
      alpha = (float *)need((nodes + a.first[nodes]) * heads, sizeof *alpha);
      wanted = (float *)need(rows * heads, sizeof *wanted);
      dn_gat_attention(&b.g, &a.g, v, b.g.in, alpha, scratch);
      for (i = 0; i < rows; i++) {
         uint32_t p = e[2 * i], q = e[2 * i + 1];
         size_t at = SIZE_MAX;
         if (p < nodes && p == q) at = a.first[p] + (size_t)p;
         else if (p < nodes)
            for (k = a.first[p]; k < a.first[p + 1]; k++)
               if (a.next[k] == q) at = k + p + 1;
         if (at == SIZE_MAX) bad++;
         else memcpy(wanted + i * heads, alpha + at * heads, heads * sizeof *alpha);
      }
      mark(r, pairs);
      if (bad || rows != nodes + a.first[nodes])
         line(r, "FAIL", "out.attention_edges", "%zu pairs, expected %zu; %zu are no edges", rows, nodes + a.first[nodes], bad);
      else line(r, "PASS", "out.attention_edges", "%zu found", rows);
      compare(r, att, "", wanted, rows, heads, heads, NULL);
      free(alpha);
      free(wanted);
      free(e);
   }
   free(v);
   free(y);
   free(raw);
   free(b.raw);
   free(prefix);
   graph_free(&a);
}

/* blocks are CASE.block.B, block.B, CASE.B or B; counted from 0 until one is missing */
static char *block_prefix(const run *r, size_t b)
{
   static const char *const forms[] = {"C.block.", "block.", "C.", ""};
   char number[32];
   size_t i;
   sprintf(number, "%lu.", (unsigned long)b);
   for (i = 0; i < COUNT(forms); i++) {
      const char *form = forms[i];
      int with_case = *form == 'C';
      char *prefix;
      if (with_case && !*r->name) continue;
      prefix = joined(with_case ? r->name : "", with_case ? form + 1 : form, number, "");
      if (find(r->model, prefix, "lin.weight", "", "")) return prefix;
      free(prefix);
   }
   return NULL;
}
static void run_dense(const run *r)
{
   const dn_tensor *x = in(r, "in.x");
   size_t nodes = dim(x, 0), d = dim(x, 1), count = 0, width = d, need_bytes = 64, b, i, at;
   dn_gat blocks[256];
   void *raws[256], *raw, *scratch;
   float *v = floats(x), *rows;
   char *prefix;
   graph a;
   while (count < COUNT(blocks) && (prefix = block_prefix(r, count)) != NULL) {
      gat g;
      int ok = gat_of(r, prefix, activation_of(r, "tanhshrink"), &g);
      free(prefix);
      if (!ok) break;
      raws[count] = g.raw;
      blocks[count] = g.g;
      count++;
      if (g.g.in != width) {
         line(r, "FAIL", "in.x", "block %zu takes %zu columns, %zu come in", count - 1, g.g.in, width);
         goto end;
      }
      width += g.g.heads * g.g.features + g.g.self;
   }
   if (!count) {
      line(r, "FAIL", "in.x", "no blocks");
      goto end;
   }
   a = graph_of_edges(in(r, "in.edges"), nodes);
   rows = (float *)need(nodes * width, sizeof *rows);
   for (i = 0; i < nodes; i++) memcpy(rows + i * width + (width - d), v + i * d, d * sizeof *v);
   for (b = 0; b < count; b++) {
      size_t s = dn_gat_scratch(&blocks[b], nodes);
      if (s > need_bytes) need_bytes = s;
   }
   scratch = block64(need_bytes, &raw);
   dn_dense_run(blocks, count, &a.g, rows, width, width, scratch, NULL);
   for (b = 0, at = width - d; b < count; b++) {
      char name[64];
      size_t w = blocks[b].heads * blocks[b].features + blocks[b].self;
      at -= w;
      sprintf(name, "mid.block.%lu", (unsigned long)b);
      compare(r, in(r, name), "", rows + at, nodes, w, width, NULL);
   }
   compare(r, in(r, "out.y"), "", rows, nodes, width, width, NULL);
   free(raw);
   free(rows);
   graph_free(&a);
end:
   while (count) free(raws[--count]);
   free(v);
}

typedef struct pool { dn_pool p; void *raw; } pool;
static int pool_of(const run *r, const char *prefix, pool *out)
{
   const dn_tensor *lin = find(r->model, prefix, "lin.weight", "", "");
   float *l = weight(r, prefix, "lin.weight"), *d = weight(r, prefix, "att_dst"), *s = weight(r, prefix, "att_src");
   float *o = weight(r, prefix, "offset");
   int ok = lin && lin->rank == 2 && d && s;
   if (ok) {
      void *memory = block64(dn_pool_size(lin->shape[1], lin->shape[0]), &out->raw);
      dn_pool_pack(&out->p, lin->shape[1], lin->shape[0], l, d, s, o ? *o : 0.0f, memory);
   }
   free(l);
   free(d);
   free(s);
   free(o);
   return ok;
}
static dn_clusters clusters_for(const dn_graph *g)
{
   dn_clusters c;
   memset(&c, 0, sizeof c);
   c.members = (uint32_t *)need(2 * g->nodes, sizeof *c.members);
   c.score = (float *)need(g->nodes, sizeof *c.score);
   c.cluster = (uint32_t *)need(g->nodes, sizeof *c.cluster);
   c.coarse_first = (uint32_t *)need(g->nodes + 1, sizeof *c.coarse_first);
   c.coarse_next = (uint32_t *)need(g->first[g->nodes], sizeof *c.coarse_next);
   return c;
}
static void clusters_free(dn_clusters *c)
{
   free(c->members);
   free(c->score);
   free(c->cluster);
   free(c->coarse_first);
   free(c->coarse_next);
}
static void run_pool(const run *r)
{
   const dn_tensor *x = in(r, "in.x"), *scores = in(r, "out.scores"), *pairs = in(r, "out.score_edges");
   size_t nodes = dim(x, 0), d = dim(x, 1), i, k, bad = 0, pass;
   char *prefix = prefix_of(r, "lin.weight");
   float *v, *score, *coarse, *back, *wanted;
   void *raw, *scratch;
   pool p;
   graph a;
   dn_clusters c;
   if (!prefix || !pool_of(r, prefix, &p)) {
      line(r, "FAIL", "in.x", "no lin.weight, att_dst, att_src");
      free(prefix);
      return;
   }
   if (p.p.in != d) {
      line(r, "FAIL", "in.x", "%zu columns, lin.weight has %zu", d, p.p.in);
      free(prefix);
      free(p.raw);
      return;
   }
   a = graph_of_edges(in(r, "in.edges"), nodes);
   v = floats(x);
   score = (float *)need(a.first[nodes], sizeof *score);
   scratch = block64(dn_pool_scratch(nodes, a.first[nodes]), &raw);
   dn_pool_scores(&p.p, &a.g, v, d, score, scratch, NULL);
   if (scores && pairs) {
      uint32_t *e = indices(pairs);
      size_t rows = pairs->count / 2;
      wanted = (float *)need(rows, sizeof *wanted);
      for (i = 0; i < rows; i++) {
         uint32_t from = e[2 * i], to = e[2 * i + 1];
         size_t at = SIZE_MAX;
         if (from < nodes)
            for (k = a.first[from]; k < a.first[from + 1]; k++)
               if (a.next[k] == to) at = k;
         if (at == SIZE_MAX) bad++;
         else wanted[i] = score[at];
      }
      mark(r, pairs);
      if (bad || rows != a.first[nodes])
         line(r, "FAIL", "out.score_edges", "%zu pairs, expected %lu; %zu are no edges", rows, (unsigned long)a.first[nodes], bad);
      else line(r, "PASS", "out.score_edges", "%zu found", rows);
      compare(r, scores, "", wanted, rows, 1, 1, NULL);
      free(wanted);
      free(e);
   }
   coarse = (float *)need(nodes * d, sizeof *coarse);
   back = (float *)need(nodes * d, sizeof *back);
   for (pass = 0; pass < 2; pass++) { /* the fast contraction, then the plain one */
      const char *part = pass ? "(reference)" : "";
      c = clusters_for(&a.g);
      if (pass) dn_pool_contract_ref(&a.g, score, &c, scratch);
      else dn_pool_contract(&a.g, score, &c, scratch);
      compare_ints(r, in(r, "out.members"), c.members, 2 * c.count);
      compare_ints(r, in(r, "out.cluster"), c.cluster, nodes);
      compare(r, in(r, "out.cluster_score"), part, c.score, c.count, 1, 1, NULL);
      compare_edges(r, in(r, "out.coarse_edges"), &c.graph);
      memset(coarse, 0xff, nodes * d * sizeof *coarse);
      memset(back, 0xff, nodes * d * sizeof *back);
      dn_pool_gather(&p.p, &c, v, d, d, coarse, d, NULL);
      compare(r, in(r, "out.coarse"), part, coarse, c.count, d, d, NULL);
      for (i = 0; i < c.count * d; i++) coarse[i] = (float)tanh((double)coarse[i]); /* out.unpooled: of tanh(coarse) */
      dn_pool_scatter(&p.p, &c, coarse, d, d, nodes, back, d, NULL);
      compare(r, in(r, "out.unpooled"), part, back, nodes, d, d, NULL);
      clusters_free(&c);
   }
   free(coarse);
   free(back);
   free(v);
   free(score);
   free(raw);
   free(p.raw);
   free(prefix);
   graph_free(&a);
}

/* --- mesh, geodesic, skinning ------------------------------------------------------------------------------ */
typedef struct mesh {
   size_t vertices, nodes, triangles;
   float *positions, *rest;                                /* (V,3), (N,3) */
   uint32_t *faces, *triangle, *node_of_vertex, *first_vertex; /* faces of vertices, triangle of nodes */
} mesh;
static int mesh_of(const run *r, int skin, mesh *m)
{
   const dn_tensor *p = in(r, "in.positions"), *f = in(r, "in.faces"), *tolerance = in(r, "in.tolerance");
   const dn_tensor *ji = skin ? in(r, "in.skin_indices") : NULL, *jw = skin ? in(r, "in.skin_weights") : NULL;
   float distance = 0, *w = NULL;
   uint32_t *j = NULL;
   void *raw;
   size_t i;
   memset(m, 0, sizeof *m);
   if (!p || p->count % 3 || p->count == 0) {
      line(r, "FAIL", "in.positions", "no vertices");
      return 0;
   }
   m->vertices = p->count / 3;
   m->triangles = f ? f->count / 3 : 0;
   m->positions = floats(p);
   m->faces = f ? indices(f) : (uint32_t *)need(1, 4);
   for (i = 0; i < 3 * m->triangles; i++)
      if (m->faces[i] >= m->vertices) {
         line(r, "FAIL", "in.faces", "triangle %zu: index %lu of %zu vertices", i / 3, (unsigned long)m->faces[i], m->vertices);
         return 0;
      }
   if (tolerance) dn_tensor_floats(tolerance, 0, 1, &distance);
   if (ji && jw) j = indices(ji), w = floats(jw);
   m->node_of_vertex = (uint32_t *)need(m->vertices, 4);
   m->first_vertex = (uint32_t *)need(m->vertices, 4);
   m->nodes = dn_weld(m->positions, m->vertices, j, w, j ? dim(ji, 1) : 0, distance, m->node_of_vertex, m->first_vertex,
                      NULL, block64(dn_weld_scratch(m->vertices), &raw));
   free(raw);
   free(j);
   free(w);
   m->rest = (float *)need(m->nodes * 3, sizeof *m->rest);
   for (i = 0; i < m->nodes; i++) memcpy(m->rest + 3 * i, m->positions + 3 * (size_t)m->first_vertex[i], 12);
   m->triangle = (uint32_t *)need(3 * m->triangles, 4);
   for (i = 0; i < 3 * m->triangles; i++) m->triangle[i] = m->node_of_vertex[m->faces[i]];
   return 1;
}
static void mesh_free(mesh *m)
{
   free(m->positions);
   free(m->rest);
   free(m->faces);
   free(m->triangle);
   free(m->node_of_vertex);
   free(m->first_vertex);
}
#include "golden_kit.h"
static void run_mesh(const run *r)
{
   mesh m;
   if (mesh_of(r, 1, &m)) {
      float *normals = (float *)need(m.nodes * 3, sizeof *normals);
      graph g = graph_of_triangles(m.triangle, m.triangles, m.nodes);
      compare_ints(r, in(r, "out.node_of_vertex"), m.node_of_vertex, m.vertices);
      compare_ints(r, in(r, "out.first_vertex"), m.first_vertex, m.nodes);
      compare_edges(r, in(r, "out.edges"), &g.g);
      dn_normals(m.rest, m.nodes, m.triangle, m.triangles, normals);
      compare(r, in(r, "out.normals"), "", normals, m.nodes, 3, 3, NULL);
      run_mesh_kit(r, &m, &g.g);
      free(normals);
      graph_free(&g);
   }
   mesh_free(&m);
}

static void run_geodesic(const run *r)
{
   static const char *const names[] = {"out.distance", "out.true"};
   const dn_tensor *joints = in(r, "in.joints"), *cell_want = in(r, "out.cell");
   const char *meta = dn_tensors_meta(r->cases->t, "golden.resolution");
   unsigned resolution = meta && atoi(meta) > 0 ? (unsigned)atoi(meta) : 128;
   size_t s, n, i, cells;
   float *j, *distance, cell = 0;
   void *raw, *scratch;
   mesh m;
   if (!mesh_of(r, 0, &m)) {
      mesh_free(&m);
      return;
   }
   s = joints->count / 3;
   j = floats(joints);
   distance = (float *)need(m.nodes * s, sizeof *distance);
   n = dn_geodesic_scratch(m.rest, m.nodes, m.triangles, resolution, 1);
   scratch = block64(n, &raw);
   if (dn_geodesic(m.rest, m.nodes, m.triangle, m.triangles, j, s, resolution, distance, &cells, &cell, scratch, n, NULL,
                   NULL) != DN_OK)
      line(r, "FAIL", "out.distance", "dn_geodesic gives up");
   else {
      compare(r, cell_want, "", &cell, 1, 1, 1, NULL);
      for (i = 0; i < COUNT(names); i++) {
         const dn_tensor *t = in(r, names[i]);
         float *want;
         double worst = 0, share = 0;
         size_t k;
         if (!t) continue;
         mark(r, t);
         if (t->count != m.nodes * s) {
            line(r, "FAIL", names[i], "the file has %zu numbers, this program %zu x %zu", t->count, m.nodes, s);
            continue;
         }
         want = floats(t);
         for (k = 0; k < t->count; k++) {
            double w = (double)want[k], e = (double)distance[k] - w;
            e = e < 0 ? -e : e;
            if (!(e <= worst)) worst = e;
            if (!(e / (0.03 * w + (double)cell) <= share)) share = e / (0.03 * w + (double)cell);
         }
         line(r, share <= 1 ? "PASS" : "FAIL", names[i], "largest error %.2e m (%.2f cells), %.3f of 3 %% + 1 cell", worst,
              worst / (double)cell, share);
         free(want);
      }
   }
   free(raw);
   free(j);
   free(distance);
   mesh_free(&m);
}

/* a rig, its scratch, and the inputs a case gives for them */
typedef struct net {
   dn_model *model;
   dn_model_info info;
   dn_rig *rig;
   dn_rig_view view;
   void *raw, *scratch;
   size_t scratch_bytes, joints, poses;
   float *palettes; /* (poses,S,12) */
   float *rows;     /* (N,D) of the last pose run */
} net;
static void net_free(net *n)
{
   free(n->raw);
   free(n->palettes);
   free(n->rows);
   dn_rig_free(n->rig);
   dn_model_free(n->model);
}
static int net_of(const run *r, bytes file_bytes, dn_skinning skinning, net *n)
{
   const dn_tensor *p = in(r, "in.positions"), *f = in(r, "in.faces"), *ji = in(r, "in.skin_indices");
   const dn_tensor *jw = in(r, "in.skin_weights"), *joints = in(r, "in.joints"), *palettes = in(r, "in.palettes");
   const dn_tensor *geodesic = in(r, "in.geodesic"), *tolerance = in(r, "in.tolerance");
   float *positions = NULL, *weights = NULL, *at = NULL, *inverse = NULL, *known = NULL;
   uint32_t *faces = NULL, *index = NULL;
   dn_skin_set skin;
   dn_rig_desc d;
   dn_error err;
   size_t i, wants_geodesic = 0;
   memset(n, 0, sizeof *n);
   memset(&d, 0, sizeof d);
   memset(&skin, 0, sizeof skin);
   if (!p || !ji || !jw || !palettes || ji->count != jw->count || palettes->rank < 2 || ji->rank != 2 ||
       ji->shape[0] != p->count / 3) {
      line(r, "FAIL", "in", "positions, skin_indices, skin_weights and palettes are needed, of one number of vertices");
      return 0;
   }
   n->joints = palettes->rank >= 4 ? palettes->shape[1] : palettes->count / 12;
   n->poses = n->joints ? palettes->count / 12 / n->joints : 0;
   n->palettes = floats(palettes);
   n->model = dn_model_load(file_bytes.data, file_bytes.size, &options, NULL, &err);
   if (!n->model) {
      line(r, "FAIL", "model", "%s: %s", dn_result_text(err.code), err.info);
      return 0;
   }
   dn_model_describe(n->model, &n->info);
   for (i = 0; i < n->info.feature_count; i++) wants_geodesic |= n->info.features[i] == DN_GEODESIC;
   positions = floats(p);
   if (f) faces = indices(f);
   index = indices(ji), weights = floats(jw);
   inverse = (float *)need(n->joints * 12, sizeof *inverse);
   at = joints ? floats(joints) : (float *)need(n->joints * 3, sizeof *at);
   for (i = 0; i < n->joints; i++) { /* joints rest unrotated: the inverse bind moves each to the origin */
      float *m = inverse + 12 * i;
      m[0] = m[5] = m[10] = 1;
      if (joints && joints->count == 3 * n->joints) m[3] = -at[3 * i], m[7] = -at[3 * i + 1], m[11] = -at[3 * i + 2];
   }
   skin.influences = ji->shape[1];
   skin.joints = index, skin.joint_type = DN_U32;
   skin.weights = weights, skin.weight_type = DN_F32;
   d.mesh.vertices = p->count / 3;
   d.mesh.positions = positions;
   d.mesh.triangles = f ? f->count / 3 : 0;
   d.mesh.indices = faces, d.mesh.index_type = DN_U32;
   d.mesh.skin_sets = 1, d.mesh.skin = &skin;
   d.skeleton.joints = n->joints;
   d.skeleton.names = n->info.joint_names;
   d.skeleton.inverse_bind = inverse, d.skeleton.matrix = DN_3X4_ROWS;
   d.skinning = skinning;
   if (tolerance) dn_tensor_floats(tolerance, 0, 1, &d.weld_distance);
   if (geodesic && wants_geodesic && geodesic->rank == 2 && geodesic->shape[1] == n->info.joints) {
      known = floats(geodesic);
      d.geodesic = known, d.geodesic_nodes = geodesic->shape[0];
   }
   if (n->info.joint_names && n->info.joints != n->joints)
      line(r, "FAIL", "in.palettes", "%zu joints, the model names %zu", n->joints, n->info.joints);
   else {
      n->rig = dn_rig_create(n->model, &d, NULL, NULL, &err);
      if (!n->rig) line(r, "FAIL", "bind", "%s: %s", dn_result_text(err.code), err.info);
   }
   free(positions);
   free(weights);
   free(at);
   free(inverse);
   free(known);
   free(faces);
   free(index);
   if (!n->rig) return 0;
   dn_rig_describe(n->rig, &n->view);
   n->scratch_bytes = dn_scratch_size(n->rig, 1);
   n->scratch = block64(n->scratch_bytes, &n->raw);
   n->rows = (float *)need(n->view.nodes * n->info.row_width, sizeof *n->rows);
   return 1;
}
static int net_run(const run *r, net *n, const float *palette, const dn_probe *probe) /* skin, rows, network */
{
   dn_pose pose;
   dn_error err;
   dn_result code;
   memset(&pose, 0, sizeof pose);
   pose.palette = palette, pose.matrix = DN_3X4_ROWS, pose.strength = 1;
   code = dn_stage_skin(n->rig, &pose, n->scratch, n->scratch_bytes, NULL, &err);
   if (code != DN_OK) {
      line(r, "FAIL", "dn_stage_skin", "%s", dn_result_text(code));
      return 0;
   }
   dn_stage_rows(n->rig, n->scratch, NULL);
   dn_rows(n->rig, n->scratch, n->rows);
   dn_stage_network(n->rig, n->scratch, NULL, probe);
   return 1;
}

/* a model that asks for every descriptor: its rows are what the file's descriptors are compared with */
static bytes descriptor_model(size_t joints, int with_geodesic, const char *frame)
{
   size_t width = 9 + joints * (with_geodesic ? 2 : 1), i, header, size = (width + 1 + 3 + 3) * 4;
   char *text = (char *)need(2048 + joints * 24, 1), *at = text;
   bytes b;
   at += sprintf(at, "{\"__metadata__\":{\"deformnet.version\":\"1\",\"deformnet.arch\":\"mlp\",\"deformnet.frame\":\"%s\","
                     "\"deformnet.features\":\"position,relative,normal%s,distance\",\"deformnet.joints\":\"",
                 frame, with_geodesic ? ",geodesic" : "");
   for (i = 0; i < joints; i++) at += sprintf(at, "%sjoint%lu", i ? "," : "", (unsigned long)i);
   at += sprintf(at, "\"},\"pre.0.weight\":{\"dtype\":\"F32\",\"shape\":[1,%lu],\"data_offsets\":[0,%lu]},",
                 (unsigned long)width, (unsigned long)width * 4);
   at += sprintf(at, "\"pre.0.bias\":{\"dtype\":\"F32\",\"shape\":[1],\"data_offsets\":[%lu,%lu]},", (unsigned long)width * 4,
                 (unsigned long)width * 4 + 4);
   at += sprintf(at, "\"out.weight\":{\"dtype\":\"F32\",\"shape\":[3,1],\"data_offsets\":[%lu,%lu]},",
                 (unsigned long)width * 4 + 4, (unsigned long)width * 4 + 16);
   at += sprintf(at, "\"out.bias\":{\"dtype\":\"F32\",\"shape\":[3],\"data_offsets\":[%lu,%lu]}}",
                 (unsigned long)width * 4 + 16, (unsigned long)size);
   while ((at - text) % 8) *at++ = ' ';
   header = (size_t)(at - text);
   b.size = 8 + header + size;
   b.data = (unsigned char *)need(b.size, 1);
   for (i = 0; i < 8; i++) b.data[i] = (unsigned char)((uint64_t)header >> (8 * i));
   memcpy(b.data + 8, text, header);
   free(text);
   return b;
}
static void columns(float *to, const float *rows, size_t count, size_t width, size_t from, size_t take)
{
   size_t i;
   for (i = 0; i < count; i++) memcpy(to + i * take, rows + i * width + from, take * sizeof *to);
}
/* rotation and palette of the root frame: all twelve numbers of every entry times the inverse of joint 0's rotation */
static void root_frame(const float *palette, size_t joints, float *rotation, float *out)
{
   float m[9];
   size_t s, i, j, k;
   for (i = 0; i < 3; i++)
      for (j = 0; j < 3; j++) m[3 * i + j] = palette[4 * i + j];
   dn_orthonormalise(m, rotation);
   for (s = 0; s < joints; s++)
      for (i = 0; i < 3; i++)
         for (j = 0; j < 4; j++) {
            double sum = 0;
            for (k = 0; k < 3; k++) sum += (double)rotation[3 * k + i] * (double)palette[12 * s + 4 * k + j];
            out[12 * s + 4 * i + j] = (float)sum;
         }
}
static void run_skinning(const run *r)
{
   const dn_tensor *palettes = in(r, "in.palettes"), *aa = in(r, "in.axis_angle"), *offsets = in(r, "in.offsets");
   const dn_tensor *parents = in(r, "in.parents"), *joints = in(r, "in.joints");
   size_t s, poses, q, i, j;
   float *p, *rotation, *root;
   if (!palettes) palettes = in(r, "in.palette");
   if (palettes->rank < 3 || palettes->shape[palettes->rank - 1] != 4 || palettes->shape[palettes->rank - 2] != 3) {
      line(r, "FAIL", "in.palettes", "not (poses,S,3,4) or (S,3,4)");
      return;
   }
   s = palettes->shape[palettes->rank - 3];
   poses = s ? palettes->count / 12 / s : 0;
   p = floats(palettes);
   rotation = (float *)need(poses * 9, sizeof *rotation);
   root = (float *)need(palettes->count, sizeof *root);
   for (q = 0; q < poses; q++) root_frame(p + q * s * 12, s, rotation + q * 9, root + q * s * 12);
   compare(r, in(r, "out.root_rotation"), "", rotation, poses, 9, 9, NULL);
   compare(r, in(r, "out.root_palette"), "", root, poses * s, 12, 12, NULL);
   if (aa && aa->count % (3 * s) == 0) { /* Rodrigues, forward kinematics, palette */
      size_t n = aa->count / 3 / s;
      float *axis = floats(aa), *local = (float *)need(n * s * 9, sizeof *local);
      for (i = 0; i < n * s; i++) dn_rodrigues(axis + 3 * i, local + 9 * i);
      compare(r, in(r, "out.rotation"), "", local, n * s, 9, 9, NULL);
      if (offsets && parents && joints && offsets->count == 3 * s && parents->count == s && joints->count == 3 * s) {
         float *o = floats(offsets), *at = floats(joints), *world = (float *)need(s * 12, sizeof *world);
         float *inverse = (float *)need(s * 12, sizeof *inverse), *fk = (float *)need(n * s * 12, sizeof *fk);
         int32_t *up = ints(parents);
         for (i = 0; i < s; i++) {
            float *m = inverse + 12 * i;
            m[0] = m[5] = m[10] = 1, m[3] = -at[3 * i], m[7] = -at[3 * i + 1], m[11] = -at[3 * i + 2];
         }
         for (q = 0; q < n; q++) {
            dn_forward_kinematics(up, o, local + q * s * 9, s, world);
            dn_palette(world, inverse, s, fk + q * s * 12);
         }
         compare(r, in(r, "out.fk_palette"), "", fk, n * s, 12, 12, NULL);
         free(o);
         free(at);
         free(world);
         free(inverse);
         free(fk);
         free(up);
      }
      free(axis);
      free(local);
   }
   if (in(r, "in.positions") && in(r, "in.palettes")) {
      static const struct { const char *out; size_t column, scale; } model_rows[] = {
         {"out.relative", 3, 0}, {"out.normal", 6, 0}, {"out.distance", 9, 1}},
                                                                     root_rows[] = {{"out.root_relative", 3, 0},
                                                                                    {"out.root_normal", 6, 0}};
      int pass, with = in(r, "in.geodesic") && dim(in(r, "in.geodesic"), 1) == s;
      for (pass = 0; pass < 3; pass++) { /* model frame with LBS, the same with DQS, root frame with LBS */
         bytes b = descriptor_model(s, with, pass == 2 ? "root" : "model");
         size_t rows = pass == 2 ? COUNT(root_rows) : pass == 0 ? COUNT(model_rows) : 0, nodes;
         float *keep[3] = {NULL, NULL, NULL}, *coarse, *direct;
         net n;
         if (net_of(r, b, pass == 1 ? DN_DQS : DN_LBS, &n)) {
            nodes = n.view.nodes;
            coarse = (float *)need(poses * nodes * 3, sizeof *coarse);
            direct = (float *)need(poses * nodes * 3, sizeof *direct);
            for (i = 0; i < rows; i++) keep[i] = (float *)need(poses * nodes * (s > 3 ? s : 3), sizeof(float));
            for (q = 0; q < poses; q++) {
               const float *x;
               float *w = (float *)need(nodes * n.view.influences, sizeof *w);
               uint32_t *index = (uint32_t *)need(nodes * n.view.influences, sizeof *index);
               if (!net_run(r, &n, p + q * s * 12, NULL)) break;
               memcpy(coarse + q * nodes * 3, dn_scratch_coarse(n.rig, n.scratch), nodes * 12);
               x = n.rows;
               for (i = 0; i < rows; i++) {
                  size_t column = pass == 2 ? root_rows[i].column : model_rows[i].column;
                  size_t wide = pass != 2 && model_rows[i].scale ? s : 3;
                  if (wide == s && pass != 2 && model_rows[i].scale && with) column += s; /* after geodesic */
                  columns(keep[i] + q * nodes * wide, x, nodes, n.info.row_width, column, wide);
               }
               for (i = 0; i < nodes; i++)
                  for (j = 0; j < n.view.influences; j++) {
                     size_t from = n.view.first_vertex[i] * n.view.influences + j;
                     index[i * n.view.influences + j] = n.view.skin_joint[from];
                     w[i * n.view.influences + j] = n.view.skin_weight[from];
                  }
               (pass == 1 ? dn_dqs : dn_lbs)(n.view.rest, index, w, n.view.influences, nodes, p + q * s * 12,
                                             direct + q * nodes * 3);
               free(w);
               free(index);
            }
            if (pass == 0) {
               compare_ints(r, in(r, "out.node_of_vertex"), n.view.node_of_vertex, n.view.vertices);
               compare_ints(r, in(r, "out.first_vertex"), n.view.first_vertex, nodes);
            }
            if (pass < 2) {
               compare(r, in(r, pass ? "out.dqs" : "out.lbs"), "", coarse, poses * nodes, 3, 3, NULL);
               compare(r, in(r, pass ? "out.dqs" : "out.lbs"), pass ? "(dn_dqs)" : "(dn_lbs)", direct, poses * nodes, 3, 3, NULL);
            }
            for (i = 0; i < rows; i++) {
               size_t wide = pass != 2 && model_rows[i].scale ? s : 3;
               compare(r, in(r, pass == 2 ? root_rows[i].out : model_rows[i].out), "", keep[i], poses * nodes, wide, wide, NULL);
               free(keep[i]);
            }
            free(coarse);
            free(direct);
         }
         net_free(&n);
         free(b.data);
      }
   }
   free(p);
   free(rotation);
   free(root);
}

/* --- >ties: which pairs of a contraction hang on less than rounding ---------------------------------------------
   Scores are floats of a softmax; two that differ by less than TIE of themselves may sort either way. A contraction
   is the greedy matching of the sorted list, so:
   - a set M of pairs is a legitimate outcome when every other directed edge e shares a node with a pair m of M that
     scores at least score(e) (1 - TIE): raise M by half of that and lower the rest, and the greedy pass gives M;
   - a pair m of ours is firm when every edge at its two nodes that scores more than score(m) (1 - TIE) is itself
     blocked by a firm pair that outscores it by TIE. Its nodes are merged so in every legitimate outcome. */
#define TIE 2e-5

typedef struct scored { float score; uint32_t i, j; } scored;
static int by_score(const void *a, const void *b)
{
   const scored *p = (const scored *)a, *q = (const scored *)b;
   if (p->score != q->score) return p->score > q->score ? -1 : 1;
   if (p->i != q->i) return p->i < q->i ? -1 : 1;
   return p->j < q->j ? -1 : p->j > q->j;
}
typedef struct ties {
   dn_clusters c;        /* our contraction */
   float *scores;        /* (2E) */
   unsigned char *loose; /* (N) the node's cluster is not the same in every legitimate outcome */
} ties;
static void ties_free(ties *t)
{
   clusters_free(&t->c);
   free(t->scores);
   free(t->loose);
}
static int above(float a, float b) { return (double)a > (double)b * (1 + TIE); }
static void find_ties(const dn_pool *p, const dn_graph *g, const float *v, ties *t)
{
   size_t n = g->nodes, i, k, c, edges = g->first[n];
   scored *order;
   unsigned char *firm; /* of a cluster */
   void *raw, *scratch = block64(dn_pool_scratch(n, edges), &raw);
   t->scores = (float *)need(edges, sizeof *t->scores);
   t->loose = (unsigned char *)need(n, 1);
   t->c = clusters_for(g);
   dn_pool_scores(p, g, v, p->in, t->scores, scratch, NULL);
   dn_pool_contract(g, t->scores, &t->c, scratch);
   free(raw);
   order = (scored *)need(t->c.count, sizeof *order);
   firm = (unsigned char *)need(t->c.count, 1);
   for (c = 0; c < t->c.count; c++) { /* pairs by falling score of the edge that made them */
      uint32_t a = t->c.members[2 * c], b = t->c.members[2 * c + 1];
      order[c].i = (uint32_t)c, order[c].score = -1;
      for (k = g->first[a]; k < g->first[a + 1] && a != b; k++)
         if (g->next[k] == b) order[c].score = t->scores[k];
   }
   {
      float *pair = (float *)need(t->c.count, sizeof *pair);
      for (c = 0; c < t->c.count; c++) pair[c] = order[c].score;
      qsort(order, t->c.count, sizeof *order, by_score);
      for (c = 0; c < t->c.count && order[c].score >= 0; c++) {
         size_t m = order[c].i, end;
         int ok = 1;
         for (end = 0; end < 2 && ok; end++) {
            uint32_t a = t->c.members[2 * m + end];
            for (k = g->first[a]; k < g->first[a + 1] && ok; k++) {
               uint32_t b = g->next[k];
               size_t other = t->c.cluster[b];
               float s = t->scores[k];
               size_t e;
               for (e = g->first[b]; e < g->first[b + 1]; e++) /* either direction makes the same pair */
                  if (g->next[e] == a && t->scores[e] > s) s = t->scores[e];
               if (other == m || above(pair[m], s)) continue;
               ok = firm[other] && above(pair[other], s);
            }
         }
         firm[m] = (unsigned char)ok;
      }
      for (i = 0; i < n; i++) {
         size_t m = t->c.cluster[i];
         if (pair[m] >= 0) t->loose[i] = !firm[m];
         else
            for (k = g->first[i]; k < g->first[i + 1]; k++)
               if (!firm[t->c.cluster[g->next[k]]]) t->loose[i] = 1;
      }
      free(pair);
   }
   free(order);
   free(firm);
}
/* one attention layer further: on the coarse graph whole clusters are reached, on the full graph single nodes */
static void widen(const dn_graph *g, const uint32_t *cluster, size_t clusters, unsigned char *reach)
{
   unsigned char *next = (unsigned char *)need(g->nodes, 1), *whole = cluster ? (unsigned char *)need(clusters, 1) : NULL;
   size_t i, k;
   for (i = 0; i < g->nodes; i++) {
      next[i] |= reach[i];
      for (k = g->first[i]; k < g->first[i + 1] && reach[i]; k++) next[g->next[k]] = 1;
   }
   if (whole) {
      for (i = 0; i < g->nodes; i++)
         if (next[i]) whole[cluster[i]] = 1;
      for (i = 0; i < g->nodes; i++) next[i] |= whole[cluster[i]];
   }
   memcpy(reach, next, g->nodes);
   free(next);
   free(whole);
}

/* --- networks ---------------------------------------------------------------------------------------------- */
typedef struct tapped { struct tapped *next; char *name; float *rows; size_t count, width; } tapped;
typedef struct pooled { struct pooled *next; char *name; uint32_t *members; float *score; size_t count; } pooled;
typedef struct taps { const run *r; tapped *rows; pooled *pools; const char *const *also; /* names, the last one NULL */ } taps;

static tapped *tapped_rows(const taps *t, const char *name)
{
   tapped *k;
   for (k = t->rows; k; k = k->next)
      if (strcmp(k->name, name) == 0) return k;
   return NULL;
}
static void tap(void *user, const char *name, const float *rows, size_t first, size_t count, size_t width, size_t stride)
{
   taps *t = (taps *)user;
   tapped *k = tapped_rows(t, name);
   char *full = joined("mid.", name, "", "");
   size_t i;
   int keep = in(t->r, full) != NULL;
   for (i = 0; t->also && t->also[i]; i++) keep |= strcmp(t->also[i], name) == 0;
   if (keep) {
      if (!k) {
         k = (tapped *)need(1, sizeof *k);
         k->name = joined(name, "", "", "");
         k->width = width;
         k->next = t->rows, t->rows = k;
      }
      if (first + count > k->count) { /* the last layers come in tiles of nodes */
         float *more = (float *)realloc(k->rows, ((first + count) * width + 1) * sizeof *more);
         if (!more) fprintf(stderr, "golden: out of memory\n"), exit(2);
         k->rows = more;
         k->count = first + count;
      }
      for (i = 0; i < count; i++) memcpy(k->rows + (first + i) * width, rows + i * stride, width * sizeof(float));
   }
   free(full);
}
static void tap_pool(void *user, const char *name, const uint32_t *members, const float *score, size_t count)
{
   taps *t = (taps *)user;
   pooled *k = (pooled *)need(1, sizeof *k);
   k->name = joined(name, "", "", "");
   k->members = (uint32_t *)need(2 * count, sizeof *k->members);
   k->score = (float *)need(count, sizeof *k->score);
   memcpy(k->members, members, 2 * count * sizeof *members);
   memcpy(k->score, score, count * sizeof *score);
   k->count = count;
   k->next = t->pools, t->pools = k;
}
static void taps_free(taps *t)
{
   while (t->rows) {
      tapped *k = t->rows;
      t->rows = k->next;
      free(k->name);
      free(k->rows);
      free(k);
   }
   while (t->pools) {
      pooled *k = t->pools;
      t->pools = k->next;
      free(k->name);
      free(k->members);
      free(k->score);
      free(k);
   }
}
static dn_probe probe_of(taps *t, const run *r, const char *const *also)
{
   dn_probe p;
   memset(t, 0, sizeof *t);
   t->r = r, t->also = also;
   p.tap = tap, p.pool = tap_pool, p.user = t;
   return p;
}
/* A pool and what comes after it: the tensors' prefix, what feeds the pool, two blocks on the coarse graph, one on all nodes */
typedef struct pooling { const char *prefix, *input, *coarse[2], *last; } pooling;
static const pooling multiresgnet_pool = {"", "pre.1", {"global.0", "global.1"}, "global.2"};
static const char *const multiresgnet_also[] = {"pre.1", NULL};

/* adds the nodes whose output a tie in this pool may change; returns how many clusters are loose */
static size_t reach_of_pool(const run *r, const taps *t, const dn_graph *g, const pooling *at, unsigned char *reach)
{
   const tapped *x = tapped_rows(t, at->input);
   char *prefix = joined(at->prefix, "pool.", "", "");
   size_t i, loose = 0;
   pool p;
   ties k;
   if (x && pool_of(r, prefix, &p)) {
      if (p.p.in == x->width && x->count == g->nodes) {
         unsigned char *mine = (unsigned char *)need(g->nodes, 1);
         find_ties(&p.p, g, x->rows, &k);
         for (i = 0; i < x->count; i++) loose += mine[i] = k.loose[i];
         widen(g, k.c.cluster, k.c.count, mine); /* first block on the coarse graph */
         widen(g, k.c.cluster, k.c.count, mine); /* second */
         widen(g, NULL, 0, mine);                /* and the one on all nodes */
         for (i = 0; i < g->nodes; i++) reach[i] |= mine[i];
         ties_free(&k);
         free(mine);
      }
      free(p.raw);
   }
   free(prefix);
   return loose;
}
static size_t reach_of_ties(const run *r, net *n, const float *palette, unsigned char *reach)
{
   taps t;
   dn_probe probe = probe_of(&t, r, multiresgnet_also);
   size_t loose = 0;
   memset(reach, 0, n->view.nodes);
   if (net_run(r, n, palette, &probe)) loose = reach_of_pool(r, &t, &n->view.graph, &multiresgnet_pool, reach);
   taps_free(&t);
   return loose;
}
static int agrees(const dn_tensor *t, const float *got)
{
   float *want = floats(t);
   int ok = row_agrees(want, got, t->count);
   free(want);
   return ok;
}

/* what a differing contraction of the file's means for the blocks behind it */
typedef struct traced {
   unsigned char *reach[4]; /* (N) nodes that feel it: in the pool, after the blocks coarse[0], coarse[1], last; NULL: none differs */
   uint32_t *row;           /* of the file's coarse node: ours, or UINT32_MAX */
   int32_t *members;        /* the file's */
   size_t coarse;
} traced;
static void traced_free(traced *k)
{
   size_t i;
   for (i = 0; i < 4; i++) free(k->reach[i]);
   free(k->row);
   free(k->members);
}
/* members and scores of one contraction, ours in q */
static void compare_pool(const run *r, const taps *t, const pooled *q, const dn_graph *g, const pooling *at, traced *out)
{
   size_t nodes = g->nodes, i, k, differ = 0, coarse;
   char *name = joined("mid.", q->name, ".members", "");
   const dn_tensor *want = in(r, name), *score;
   const tapped *x = tapped_rows(t, at->input);
   int32_t *m;
   pool p;
   int known;
   free(name);
   name = joined("mid.", q->name, ".score", "");
   score = in(r, name);
   free(name);
   if (!want) {
      compare(r, score, "", q->score, q->count, 1, 1, NULL);
      return;
   }
   m = ints(want);
   coarse = want->count / 2;
   if (coarse != q->count) differ = 1;
   else
      for (i = 0; i < 2 * coarse; i++) differ += m[i] != (int32_t)q->members[i];
   name = joined(at->prefix, "pool.", "", "");
   known = differ && x && x->count == nodes && pool_of(r, name, &p);
   free(name);
   if (!known) {
      compare_ints(r, want, q->members, 2 * q->count);
      compare(r, score, "", q->score, q->count, 1, 1, NULL);
      free(m);
      return;
   }
   {
      ties k2;
      uint32_t *theirs = (uint32_t *)need(nodes, 4); /* the other member of each node's pair in the file */
      size_t illegal = 0, valid = 1, unlike = 0;
      find_ties(&p.p, g, x->rows, &k2);
      for (i = 0; i < nodes; i++) theirs[i] = UINT32_MAX;
      for (i = 0; i < coarse && valid; i++) {
         if (m[2 * i] < 0 || m[2 * i + 1] < 0 || (size_t)m[2 * i] >= nodes || (size_t)m[2 * i + 1] >= nodes ||
             theirs[m[2 * i]] != UINT32_MAX || theirs[m[2 * i + 1]] != UINT32_MAX)
            valid = 0;
         else theirs[m[2 * i]] = (uint32_t)m[2 * i + 1], theirs[m[2 * i + 1]] = (uint32_t)m[2 * i];
      }
      if (valid) { /* every edge left out must be blocked by one of the file's pairs that scores as much or ties */
         float *chosen = (float *)need(nodes, sizeof *chosen);
         for (i = 0; i < nodes; i++) chosen[i] = -1;
         for (i = 0; i < coarse; i++) {
            uint32_t a = (uint32_t)m[2 * i], b = (uint32_t)m[2 * i + 1];
            float s = -1;
            for (k = g->first[a]; k < g->first[a + 1]; k++)
               if (g->next[k] == b) s = k2.scores[k];
            if (a != b && s < 0) valid = 0;
            chosen[a] = chosen[b] = s;
         }
         for (i = 0; i < nodes; i++)
            for (k = g->first[i]; k < g->first[i + 1]; k++) {
               float best = chosen[i] > chosen[g->next[k]] ? chosen[i] : chosen[g->next[k]];
               if (above(k2.scores[k], best)) illegal++;
            }
         free(chosen);
      }
      mark(r, want);
      if (valid && !illegal) {
         out->row = (uint32_t *)need(coarse, sizeof *out->row);
         for (i = 0; i < 4; i++) out->reach[i] = (unsigned char *)need(nodes, 1);
         for (i = 0; i < coarse; i++) {
            uint32_t a = (uint32_t)m[2 * i], b = (uint32_t)m[2 * i + 1], c = k2.c.cluster[a], d = k2.c.cluster[b];
            const uint32_t *own = k2.c.members + 2 * (size_t)c;
            out->row[i] = UINT32_MAX;
            if (c == d && c < q->count && own[0] == a && own[1] == b) out->row[i] = c;
            else {
               out->reach[0][a] = out->reach[0][b] = 1, unlike++;
               out->reach[0][own[0]] = out->reach[0][own[1]] = 1;
               out->reach[0][k2.c.members[2 * d]] = out->reach[0][k2.c.members[2 * d + 1]] = 1;
            }
         }
         for (i = 1; i < 3; i++) {
            memcpy(out->reach[i], out->reach[i - 1], nodes);
            widen(g, k2.c.cluster, k2.c.count, out->reach[i]);
            for (k = 0; k < nodes; k++) /* whole clusters of the file's, too */
               if (out->reach[i][k] && theirs[k] != UINT32_MAX) out->reach[i][theirs[k]] = 1;
         }
         memcpy(out->reach[3], out->reach[2], nodes);
         widen(g, NULL, 0, out->reach[3]);
         out->members = m, out->coarse = coarse;
         excused_total += unlike;
         line(r, "PASS", short_name(r, want), "%zu of %zu pairs differ, every one by a tie within %.0e of the score", unlike,
              coarse, TIE);
         if (score) {
            float *s = (float *)need(coarse, sizeof *s);
            unsigned char *excuse = (unsigned char *)need(coarse, 1);
            for (i = 0; i < coarse; i++)
               if (out->row[i] == UINT32_MAX) excuse[i] = 1;
               else s[i] = q->score[out->row[i]];
            compare(r, score, "", s, coarse, 1, 1, excuse);
            free(s);
            free(excuse);
         }
      } else {
         line(r, "FAIL", short_name(r, want), valid ? "%zu edges outscore the file's pairs that block them"
                                                    : "the file's pairs are not a matching of this graph (%zu)", illegal);
         compare(r, score, "", q->score, q->count, 1, 1, NULL);
         free(m);
      }
      free(theirs);
      free(p.raw);
      ties_free(&k2);
   }
}
/* where a block stands to a pool: 0 the pool, 1 and 2 the blocks on the coarse graph (2 the unpooled rows, too), 3 what
   follows on all nodes, 4 not behind it */
static int level_of(const pooling *at, const char *name, int *on_nodes)
{
   size_t n = strlen(at->prefix);
   *on_nodes = 0;
   if (strncmp(name, at->prefix, n) != 0) return 4;
   name += n;
   if (strcmp(name, "pool") == 0) return 0;
   if (strcmp(name, at->coarse[0]) == 0) return 1;
   if (strcmp(name, at->coarse[1]) == 0) return 2;
   *on_nodes = 1;
   if (strcmp(name, "unpool") == 0) return 2;
   return strcmp(name, at->last) == 0 || strncmp(name, "post.", 5) == 0 || strcmp(name, "out") == 0 ? 3 : 4;
}
/* What a block gives for the file's own input to it: (count,width) rows to free, or NULL when the file does not tell.
   Where a chain of blocks magnifies its rounding (unpooling divides by a score, the normals of a thin triangle by its
   height), a block that is too far off at the end of the chain is judged by itself; the line says so. Blocks that are
   joined up wrongly are off everywhere and by far: that stays a failure. */
typedef struct alone { float *(*rows)(const struct alone *a, const char *name, size_t count, size_t width); const void *user; } alone;
static int compare_or_alone(const run *r, const dn_tensor *want, const char *name, const tapped *x, const unsigned char *excused,
                            const alone *a)
{
   float *w = want->count == x->count * x->width ? floats(want) : NULL, *rows = NULL;
   double share = 0, by_itself = 0;
   size_t i, bad = 0;
   for (i = 0; w && i < x->count; i++) bad += !(excused && excused[i]) && !row_agrees(w + i * x->width, x->rows + i * x->width, x->width);
   if (bad && a) rows = a->rows(a, name, x->count, x->width);
   for (i = 0; rows && i < want->count; i++) {
      double v = (double)w[i], allowed = absolute + relative * (v < 0 ? -v : v), e = v - (double)x->rows[i], f = v - (double)rows[i];
      e = (e < 0 ? -e : e) / allowed, f = (f < 0 ? -f : f) / allowed;
      if (!(e <= share)) share = e;
      if (!(f <= by_itself)) by_itself = f;
   }
   free(w);
   if (!rows || !(by_itself <= 1) || (share > 30 && bad * 20 > x->count)) {
      free(rows);
      return compare(r, want, "", x->rows, x->count, x->width, x->width, excused);
   }
   free(rows);
   mark(r, want);
   if (!(by_itself <= case_share)) case_share = by_itself;
   line(r, "PASS", short_name(r, want), "%.3f of the tolerance from the file's own input; %.3f after all blocks before it (%zu rows)",
        by_itself, share, bad);
   return 1;
}
/* every block that was tapped, against the file's intermediate tensors. felt (N) or NULL: nodes where another cause
   excuses a difference in everything behind it; a or NULL: see above */
static void compare_blocks(const run *r, const taps *t, const dn_graph *g, const pooling *pools, size_t count,
                           const unsigned char *felt, const alone *a)
{
   traced found[2];
   const pooled *q;
   size_t i, k, b;
   memset(found, 0, sizeof found);
   for (q = t->pools; q; q = q->next)
      for (b = 0; b < count && b < COUNT(found); b++) {
         char *name = joined(pools[b].prefix, "pool", "", "");
         if (strcmp(q->name, name) == 0) compare_pool(r, t, q, g, &pools[b], &found[b]);
         free(name);
      }
   for (i = 0; i < dn_tensors_count(r->cases->t); i++) { /* in the file's order */
      const dn_tensor *want = dn_tensors_at(r->cases->t, i);
      const tapped *x = NULL;
      const traced *at = NULL;
      char *prefix = joined("golden.", r->name, *r->name ? "." : "", "mid.");
      const char *name = want->name + strlen(prefix);
      int mine = strncmp(want->name, prefix, strlen(prefix)) == 0, level = 4, on_nodes = 0;
      free(prefix);
      if (!mine || r->done[i] || (x = tapped_rows(t, name)) == NULL) continue;
      for (b = 0; b < count && b < COUNT(found) && level == 4; b++)
         if (found[b].row) level = level_of(&pools[b], name, &on_nodes), at = &found[b];
      if (level == 4) compare_or_alone(r, want, name, x, x->count == g->nodes ? felt : NULL, a);
      else if (on_nodes) compare(r, want, "", x->rows, x->count, x->width, x->width, at->reach[level]);
      else { /* coarse rows, in the file's order of clusters */
         float *rows = (float *)need(at->coarse * x->width, sizeof *rows);
         unsigned char *out = (unsigned char *)need(at->coarse, 1);
         for (k = 0; k < at->coarse; k++)
            if (at->row[k] == UINT32_MAX || at->reach[level][at->members[2 * k]]) out[k] = 1;
            else memcpy(rows + k * x->width, x->rows + at->row[k] * x->width, x->width * sizeof *rows);
         compare(r, want, "", rows, at->coarse, x->width, x->width, out);
         free(rows);
         free(out);
      }
   }
   for (b = 0; b < COUNT(found); b++) traced_free(&found[b]);
}
/* the intermediate tensors of the first pose */
static void compare_mid(const run *r, net *n)
{
   taps t;
   dn_probe probe = probe_of(&t, r, multiresgnet_also);
   if (net_run(r, n, n->palettes, &probe)) {
      compare(r, in(r, "mid.features"), "", n->rows, n->view.nodes, n->info.row_width, n->info.row_width, NULL);
      compare_blocks(r, &t, &n->view.graph, &multiresgnet_pool, 1, NULL, NULL);
   }
   taps_free(&t);
}

static void run_network(const run *r)
{
   static const struct { const char *out, *pooling, *frame; } variants[] = {
      {"out.displacement", "dynamic", NULL},
      {"out.displacement_rest_pooling", "rest", NULL},
      {"out.displacement_root_frame", "dynamic", "root"},
      {"out.displacement_rest_pooling_root_frame", "rest", "root"},
      {"out.displacement_root_frame_rest_pooling", "rest", "root"}};
   size_t v, q, i, nodes;
   int pools = find(r->model, "pool.lin.weight", "", "", "") != NULL;
   for (v = 0; v < COUNT(variants); v++) {
      const dn_tensor *want = in(r, variants[v].out);
      const char *frame;
      bytes b, c;
      net n;
      if (v && !want) continue;
      b = set_meta(r->model->b, "deformnet.pooling", variants[v].pooling);
      frame = variants[v].frame ? variants[v].frame : in(r, "out.displacement_root_frame") ? "model" : NULL; /* NULL: the file's */
      if (frame) c = set_meta(b, "deformnet.frame", frame), free(b.data), b = c;
      if (net_of(r, b, DN_LBS, &n)) {
         float *coarse, *delta, *shown;
         nodes = n.view.nodes;
         coarse = (float *)need(n.poses * nodes * 3, sizeof *coarse);
         delta = (float *)need(n.poses * nodes * 3, sizeof *delta);
         shown = (float *)need(n.poses * n.view.vertices * 3, sizeof *shown);
         if (v == 0) {
            compare_ints(r, in(r, "out.node_of_vertex"), n.view.node_of_vertex, n.view.vertices);
            compare_ints(r, in(r, "out.first_vertex"), n.view.first_vertex, nodes);
            if (n.poses) compare_mid(r, &n);
         }
         for (q = 0; q < n.poses; q++) {
            dn_pose pose;
            dn_output out;
            memset(&pose, 0, sizeof pose);
            memset(&out, 0, sizeof out);
            pose.palette = n.palettes + q * n.joints * 12, pose.strength = 1;
            out.displacement = shown + q * n.view.vertices * 3;
            if (dn_deform(n.rig, &pose, &out, n.scratch, n.scratch_bytes, NULL, NULL) != DN_OK)
               line(r, "FAIL", "dn_deform", "pose %zu: %zu nodes fell back", q, out.fallback_nodes);
            memcpy(coarse + q * nodes * 3, dn_scratch_coarse(n.rig, n.scratch), nodes * 12);
            memcpy(delta + q * nodes * 3, dn_scratch_displacement(n.rig, n.scratch), nodes * 12);
         }
         if (v == 0) compare(r, in(r, "out.coarse"), "", coarse, n.poses * nodes, 3, 3, NULL);
         if (want) {
            unsigned char *excused = NULL;
            float *by_node = (float *)need(n.poses * nodes * 3, sizeof *by_node);
            if (pools && want->count == n.poses * nodes * 3 && !agrees(want, delta)) { /* may ties explain it? */
               net dynamic;
               bytes d = set_meta(b, "deformnet.pooling", "dynamic");
               size_t loose = 0;
               excused = (unsigned char *)need(n.poses * nodes, 1);
               if (net_of(r, d, DN_LBS, &dynamic)) {
                  float *identity = (float *)need(n.joints * 12, sizeof *identity);
                  for (i = 0; i < n.joints; i++) identity[12 * i] = identity[12 * i + 5] = identity[12 * i + 10] = 1;
                  for (q = 0; q < n.poses; q++)
                     loose += reach_of_ties(r, &dynamic, n.info.pooling == DN_POOL_REST ? identity : n.palettes + q * n.joints * 12,
                                            excused + q * nodes);
                  free(identity);
               }
               net_free(&dynamic);
               free(d.data);
               printf("       %s: %zu nodes hang on scores that tie within %.0e\n", variants[v].out, loose, TIE);
            }
            compare(r, want, "", delta, n.poses * nodes, 3, 3, excused);
            for (q = 0; q < n.poses; q++) /* what reaches the vertices: refined minus skinned */
               for (i = 0; i < nodes; i++)
                  memcpy(by_node + 3 * (q * nodes + i), shown + 3 * (q * n.view.vertices + n.view.first_vertex[i]), 12);
            compare(r, want, "(vertices)", by_node, n.poses * nodes, 3, 3, excused);
            for (i = 0; i < n.poses * n.view.vertices; i++) {
               size_t vertex = i % n.view.vertices, first = n.view.first_vertex[n.view.node_of_vertex[vertex]];
               double e = 0;
               for (q = 0; q < 3; q++) {
                  double a = (double)shown[3 * i + q] - (double)shown[3 * (i - vertex + first) + q];
                  e = a * a > e ? a * a : e;
               }
               if (e > 1e-10) {
                  line(r, "FAIL", variants[v].out, "vertex %zu moves apart from its node", vertex);
                  break;
               }
            }
            free(by_node);
            free(excused);
         }
         free(coarse);
         free(delta);
         free(shown);
      }
      net_free(&n);
      free(b.data);
   }
}

#include "golden_blend.h"

#include "golden_garment.h"

/* --- which kind of case is it ------------------------------------------------------------------------------ */
static int has_prefix(const run *r, const char *suffix) /* weights of this kind under this case's name, or unnamed */
{
   char *p = prefix_of(r, suffix);
   int found = p != NULL;
   free(p);
   return found;
}
static void run_case(run *r, const char *path)
{
   static const char *const archs[] = {"mlp", "gat", "neuroskinning", "densegats", "multiresgnet"};
   const char *arch = dn_tensors_meta(r->model->t, "deformnet.arch");
   size_t i, before = passed + failed, before_passed = passed, n = dn_tensors_count(r->cases->t);
   int known = 0;
   case_share = 0;
   r->done = (unsigned char *)need(n, 1);
   if (run_blend_case(r, arch)) known = 1;
   else if (arch) {
      for (i = 0; i < COUNT(archs); i++) known |= strcmp(arch, archs[i]) == 0;
      if (known) run_network(r);
      if (is_garment(arch)) known = 1, run_garment(r, arch);
   } else if (in(r, "in.direction") && in(r, "in.length")) {
      known = 1;
      run_decompose(r);
   } else if (in(r, "in.x") && !in(r, "in.faces") && !in(r, "in.attention")) {
      char *block = in(r, "in.edges") ? block_prefix(r, 0) : NULL;
      known = 1;
      if (block && !has_prefix(r, "lin.weight")) run_dense(r);
      else if (in(r, "in.edges") && (in(r, "out.scores") || in(r, "out.members") || in(r, "out.cluster") || in(r, "out.unpooled")))
         run_pool(r);
      else if (in(r, "in.edges")) run_gat(r);
      else if (has_prefix(r, "weight")) run_linear(r);
      else known = 0;
      free(block);
   } else if (in(r, "in.palettes") || in(r, "in.palette")) known = 1, run_skinning(r);
   else if (in(r, "in.positions") && in(r, "in.joints") && (in(r, "out.distance") || in(r, "out.true"))) known = 1, run_geodesic(r);
   else if (in(r, "in.positions") && in(r, "in.faces") && !in(r, "in.x") && !in(r, "in.axis_angle")) known = 1, run_mesh(r);
   else if (in(r, "in.distances")) known = 1, run_factor(r);
   if (!known) printf("       %s %s: %s%s is not in this version\n", path, r->name, arch ? "architecture " : "this kind of case", arch ? arch : "");
   for (i = 0; i < n; i++) { /* what nothing above has looked at */
      const dn_tensor *t = dn_tensors_at(r->cases->t, i);
      char *out = joined("golden.", r->name, *r->name ? "." : "", "out."), *mid = joined("golden.", r->name, *r->name ? "." : "", "mid.");
      int mine = strncmp(t->name, out, strlen(out)) == 0 || strncmp(t->name, mid, strlen(mid)) == 0;
      free(out);
      free(mid);
      if (mine && !r->done[i]) line(r, "SKIP", short_name(r, t), known ? "unknown tensor" : "not in this version");
   }
   if (known && passed + failed == before) line(r, "FAIL", "out", "nothing to compare in this case");
   if (brief && known)
      printf("  %s %-14s %zu of %zu tensors, at most %.3f of the tolerance\n", passed - before_passed == passed + failed - before ? "PASS" : "FAIL",
             r->name, passed - before_passed, passed + failed - before, case_share);
   free(r->done);
}

/* "golden.CASE.in.NAME": the length of CASE, 0 when there is none, SIZE_MAX for other names */
static size_t case_length(const char *name)
{
   static const char *const kinds[] = {".in.", ".mid.", ".out."};
   size_t i, best = SIZE_MAX;
   if (strncmp(name, "golden.", 7) != 0) return SIZE_MAX;
   for (i = 0; i < COUNT(kinds); i++) {
      const char *at = strstr(name + 6, kinds[i]);
      if (at && (size_t)(at - name) < best) best = (size_t)(at - name);
   }
   return best == SIZE_MAX ? SIZE_MAX : best == 6 ? 0 : best - 7;
}
static void run_cases(const file *model, const file *cases, const char *path)
{
   size_t i, k, n = dn_tensors_count(cases->t), found = 0;
   const char *arch = dn_tensors_meta(model->t, "deformnet.arch");
   char **names = (char **)need(n, sizeof *names);
   printf("%s%s%s%s\n", path, arch ? " (" : "", arch ? arch : "", arch ? ")" : "");
   for (i = 0; i < n; i++) {
      const char *name = dn_tensors_at(cases->t, i)->name;
      size_t length = case_length(name);
      int seen = 0;
      if (length == SIZE_MAX) continue;
      for (k = found; k-- > 0 && !seen;) seen = strlen(names[k]) == length && strncmp(names[k], name + 7, length) == 0;
      if (seen) continue;
      names[found] = (char *)need(length + 1, 1);
      memcpy(names[found++], name + 7, length);
   }
   for (k = 0; k < found; k++) {
      run r;
      r.model = model, r.cases = cases, r.name = names[k], r.done = NULL;
      run_case(&r, path);
      fflush(stdout);
   }
   if (!found) failed++, printf("FAIL %s: no golden tensors in it\n", path);
   for (k = 0; k < found; k++) free(names[k]);
   free(names);
}


static void run_files(int argc, char **argv, const file *model)
{
   int i;
   for (i = 1; i < argc; i++) {
      file cases;
      bytes b;
      if (strncmp(argv[i], "--", 2) == 0) {
         i += strcmp(argv[i], "--brief") != 0 && strcmp(argv[i], "--every-kernel") != 0; /* the others take a value */
         continue;
      }
      b = read_file(argv[i]);
      if (!b.data) {
         printf("FAIL %s: cannot read it\n", argv[i]), failed++;
         continue;
      }
      if (!open_bytes(&cases, b, argv[i])) failed++;
      else run_cases(model->t ? model : &cases, &cases, argv[i]);
      close_file(&cases);
   }
}
int main(int argc, char **argv)
{
   const char *model_path = NULL;
   file model;
   size_t k;
   int i, files = 0, every = 0, wrong = 0;
   memset(&model, 0, sizeof model);
   for (i = 1; i < argc; i++)
      if (strcmp(argv[i], "--model") == 0 && i + 1 < argc) model_path = argv[++i];
      else if (strcmp(argv[i], "--tolerance") == 0 && i + 1 < argc) {
         char *end;
         absolute = strtod(argv[++i], &end);
         if (*end || !(absolute > 0)) fprintf(stderr, "golden: --tolerance takes a number above 0\n"), exit(2);
      } else if (strcmp(argv[i], "--kernel") == 0 && i + 1 < argc) {
         for (k = DN_KERNEL_REF, i++; k < DN_KERNEL_COUNT; k++)
            if (strcmp(argv[i], dn_kernel_name((dn_kernel)k)) == 0) options.kernel = (dn_kernel)k;
         if (!dn_kernel_available(options.kernel))
            fprintf(stderr, "golden: kernel %s does not run here\n", argv[i]), exit(2);
      } else if (strcmp(argv[i], "--every-kernel") == 0) every = 1;
      else if (strcmp(argv[i], "--brief") == 0) brief = 1;
      else if (strncmp(argv[i], "--", 2) == 0) wrong = 1;
      else files++;
   if (wrong || files == 0) {
      fprintf(stderr, "usage: golden [--model M.safetensors] [--tolerance X] [--kernel NAME | --every-kernel] [--brief] FILE...\n");
      return 2;
   }
   if (model_path) {
      bytes b = read_file(model_path);
      if (!b.data || !open_bytes(&model, b, model_path)) {
         printf("FAIL %s: cannot read it as a model\ngolden: 0 passed, 1 failed\n", model_path);
         return 1;
      }
   }
   for (k = 0; k < (every ? (size_t)DN_KERNEL_COUNT : 1); k++) {
      if (every && !dn_kernel_available((dn_kernel)k)) continue;
      if (every) options.kernel = (dn_kernel)k;
      printf("kernel %s, tolerance %g + %g |x|\n", dn_kernel_name(options.kernel), absolute, relative);
      run_files(argc, argv, &model);
   }
   close_file(&model);
   printf("%zu tensors skipped, %zu rows or pairs left out as ties\n", skipped, excused_total);
   printf("golden: %zu passed, %zu failed\n", passed, failed);
   return failed || !(passed + skipped);
}
