/*  tensors.c - see tensors.h */
#include "tensors.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const struct { const char *name; size_t size; } types[EX_DTYPES] = {
   {"BOOL", 1}, {"U8", 1}, {"I8", 1}, {"U16", 2}, {"I16", 2}, {"F16", 2}, {"BF16", 2},
   {"U32", 4}, {"I32", 4}, {"F32", 4}, {"U64", 8}, {"I64", 8}, {"F64", 8}
};
size_t ex_dtype_size(ex_dtype type) { return (unsigned)type < EX_DTYPES ? types[type].size : 0; }
const char *ex_dtype_name(ex_dtype type) { return (unsigned)type < EX_DTYPES ? types[type].name : "?"; }

int ex_fail(char *error, const char *path, const char *format, ...)
{
   va_list list;
   int n;
   if (!error) return 0;
   n = snprintf(error, EX_ERROR, "%.120s: ", path);
   va_start(list, format);
   vsnprintf(error + n, EX_ERROR - (size_t)n, format, list);
   va_end(list);
   return 0;
}

/* ------------------------------------------------- reading */
typedef struct entry { char *key, *value; } entry;
struct ex_tensors {
   char *path;
   unsigned char *raw, *data;    /* the header, and the rows in a block of their own: aligned */
   size_t tensors, entries;
   ex_tensor *tensor;
   entry *meta;
   void **moved;                 /* copies of tensors that are not aligned for their type */
   size_t moves;
};

/* The header is JSON, but only this much of it: objects, strings, arrays of whole numbers. */
typedef struct scan { const char *p, *end; const char *wrong; } scan;
static void skip(scan *s) { while (s->p < s->end && (*s->p == ' ' || *s->p == '\t' || *s->p == '\n' || *s->p == '\r')) s->p++; }
static int peek(scan *s) { skip(s); return s->p < s->end ? *s->p : 0; }
static int take(scan *s, char c)
{
   if (peek(s) != c) { if (!s->wrong) s->wrong = "the header is not well-formed JSON"; return 0; }
   s->p++;
   return 1;
}
static int hex4(scan *s, unsigned *out)
{
   unsigned v = 0;
   int i;
   if (s->end - s->p < 4) return 0;
   for (i = 0; i < 4; i++) {
      int c = *s->p++, d = c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
      if (d < 0) return 0;
      v = v * 16 + (unsigned)d;
   }
   *out = v;
   return 1;
}
static char *utf8(char *o, unsigned u)
{
   if (u < 0x80) *o++ = (char)u;
   else if (u < 0x800) { *o++ = (char)(0xC0 | u >> 6); *o++ = (char)(0x80 | (u & 63)); }
   else if (u < 0x10000) { *o++ = (char)(0xE0 | u >> 12); *o++ = (char)(0x80 | (u >> 6 & 63)); *o++ = (char)(0x80 | (u & 63)); }
   else { *o++ = (char)(0xF0 | u >> 18); *o++ = (char)(0x80 | (u >> 12 & 63)); *o++ = (char)(0x80 | (u >> 6 & 63)); *o++ = (char)(0x80 | (u & 63)); }
   return o;
}
static char *text(scan *s) /* a string, unescaped, to be freed; NULL and s->wrong when there is none */
{
   const char *q;
   char *out, *o;
   if (!take(s, '"')) return NULL;
   for (q = s->p; q < s->end && *q != '"'; q++) if (*q == '\\') q++;
   if (q >= s->end) { s->wrong = "a string in the header has no end"; return NULL; }
   out = o = (char *)malloc((size_t)(q - s->p) + 1);
   if (!out) { s->wrong = "out of memory"; return NULL; }
   while (*s->p != '"') {
      unsigned u, low;
      char c = *s->p++;
      if ((unsigned char)c < 32) { s->wrong = "control character in a string of the header"; free(out); return NULL; }
      if (c != '\\') { *o++ = c; continue; }
      c = *s->p++;
      if (c == 'u') {
         if (!hex4(s, &u)) { s->wrong = "bad \\u escape in the header"; free(out); return NULL; }
         if (u >= 0xD800 && u < 0xDC00 && s->end - s->p >= 6 && s->p[0] == '\\' && s->p[1] == 'u') {
            s->p += 2;
            if (!hex4(s, &low)) { s->wrong = "bad \\u escape in the header"; free(out); return NULL; }
            u = 0x10000 + ((u - 0xD800) << 10) + ((low - 0xDC00) & 0x3FF);
         }
         if (u == 0) u = 0xFFFD;  /* a string here ends at its first zero byte */
         o = utf8(o, u);          /* never longer than its escape */
      } else {
         static const char from[] = "\"\\/bfnrt", to[] = "\"\\/\b\f\n\r\t";
         const char *k = c ? strchr(from, c) : NULL;
         if (!k) { s->wrong = "bad escape in the header"; free(out); return NULL; }
         *o++ = to[k - from];
      }
   }
   s->p++;
   *o = 0;
   return out;
}
static int whole(scan *s, uint64_t *out)
{
   uint64_t v = 0;
   int n = 0;
   for (skip(s); s->p < s->end && *s->p >= '0' && *s->p <= '9'; s->p++, n++) {
      unsigned d = (unsigned)(*s->p - '0');
      if (v > (UINT64_MAX - d) / 10) { s->wrong = "a number in the header is too large"; return 0; }
      v = v * 10 + d;
   }
   if (!n) { s->wrong = "a whole number is missing in the header"; return 0; }
   *out = v;
   return 1;
}
static void *grow(void *list, size_t count, size_t size) /* room for one more; NULL: out of memory, list untouched */
{
   if (count & (count - 1)) return list;   /* grows when count is a power of two */
   if (count > SIZE_MAX / 4 / size) return NULL;
   return realloc(list, (count ? 2 * count : 1) * size);
}
static int read_meta(ex_tensors *f, scan *s)
{
   if (!take(s, '{')) return 0;
   while (peek(s) != '}') {
      entry e, *list = (entry *)grow(f->meta, f->entries, sizeof *f->meta);
      if (!list) { s->wrong = "out of memory"; return 0; }
      f->meta = list;
      if (f->entries && !take(s, ',')) return 0;
      if (!(e.key = text(s))) return 0;
      e.value = take(s, ':') ? text(s) : NULL;
      if (!e.value) { free(e.key); return 0; }
      f->meta[f->entries++] = e;
   }
   s->p++;
   return 1;
}
static int read_tensor(ex_tensors *f, scan *s, char *name, uint64_t size)
{
   ex_tensor t, *list = (ex_tensor *)grow(f->tensor, f->tensors, sizeof *f->tensor);
   int first = 1, have = 0;
   uint64_t a = 0, b = 0;
   memset(&t, 0, sizeof t);
   t.name = name;
   if (!list) { s->wrong = "out of memory"; free(name); return 0; }
   f->tensor = list;
   f->tensor[f->tensors++] = t; /* owns the name from here on */
   if (!take(s, '{')) return 0;
   for (; peek(s) != '}'; first = 0) {
      char *key, *value;
      int k;
      if (!first && !take(s, ',')) return 0;
      if (!(key = text(s))) return 0;
      k = !strcmp(key, "dtype") ? 1 : !strcmp(key, "shape") ? 2 : !strcmp(key, "data_offsets") ? 4 : 0;
      free(key);
      if (!k || (have & k)) { s->wrong = "a tensor has an unknown or repeated field"; return 0; }
      have |= k;
      if (!take(s, ':')) return 0;
      if (k == 1) {
         int i;
         if (!(value = text(s))) return 0;
         for (i = 0; i < EX_DTYPES && strcmp(value, types[i].name); i++) {}
         free(value);
         if (i == EX_DTYPES) { s->wrong = "a tensor has an unknown dtype"; return 0; }
         t.type = (ex_dtype)i;
      } else if (k == 2) {
         if (!take(s, '[')) return 0;
         while (peek(s) != ']') {
            uint64_t v;
            if (t.rank == EX_MAX_RANK) { s->wrong = "a tensor has more than eight sides"; return 0; }
            if (t.rank && !take(s, ',')) return 0;
            if (!whole(s, &v)) return 0;
            if (v > SIZE_MAX / 8) { s->wrong = "a tensor is larger than its file"; return 0; }
            t.shape[t.rank++] = (size_t)v;
         }
         s->p++;
      } else if (!take(s, '[') || !whole(s, &a) || !take(s, ',') || !whole(s, &b) || !take(s, ']')) return 0;
   }
   s->p++;
   if (have != 7) { s->wrong = "a tensor lacks dtype, shape or data_offsets"; return 0; }
   {
      size_t i, n = 1;
      for (i = 0; i < t.rank; i++) {
         if (t.shape[i] && n > SIZE_MAX / 8 / t.shape[i]) { s->wrong = "a tensor is larger than its file"; return 0; }
         n *= t.shape[i];
      }
      for (; i < EX_MAX_RANK; i++) t.shape[i] = 1;
      t.count = n;
      t.bytes = n * ex_dtype_size(t.type);
   }
   if (a > b || b > size || b - a != t.bytes) { s->wrong = "data_offsets do not fit shape, dtype or file"; return 0; }
   t.data = f->data + (size_t)a;
   if (a % ex_dtype_size(t.type)) {   /* the format promises no alignment */
      void **moved = (void **)grow(f->moved, f->moves, sizeof *f->moved), *copy = malloc(t.bytes ? t.bytes : 1);
      if (moved) f->moved = moved;
      if (!moved || !copy) { free(copy); s->wrong = "out of memory"; return 0; }
      memcpy(copy, t.data, t.bytes);
      t.data = f->moved[f->moves++] = copy;
   }
   f->tensor[f->tensors - 1] = t;
   return 1;
}
static char *copy_text(const char *s)
{
   size_t n = strlen(s) + 1;
   char *r = (char *)malloc(n);
   if (r) memcpy(r, s, n);
   return r;
}
ex_tensors *ex_tensors_open(const char *path, char *error)
{
   unsigned char lead[8];
   uint64_t head = 0, size;
   long end;
   int i, first = 1;
   scan s;
   FILE *in = fopen(path, "rb");
   ex_tensors *f = (ex_tensors *)calloc(1, sizeof *f);
   memset(&s, 0, sizeof s);
   if (!in) { ex_fail(error, path, "cannot be opened"); goto fail; }
   if (!f || !(f->path = copy_text(path))) { ex_fail(error, path, "out of memory"); goto fail; }
   if (fseek(in, 0, SEEK_END) || (end = ftell(in)) < 0 || fseek(in, 0, SEEK_SET)) { ex_fail(error, path, "cannot be read"); goto fail; }
   if (end < 10 || fread(lead, 1, 8, in) != 8) { ex_fail(error, path, "is no safetensors file: only %ld bytes", end); goto fail; }
   for (i = 7; i >= 0; i--) head = head << 8 | lead[i];
   if (head > (uint64_t)end - 8 || head < 2) { ex_fail(error, path, "is no safetensors file: header length %llu in %ld bytes", (unsigned long long)head, end); goto fail; }
   size = (uint64_t)end - 8 - head;
   f->raw = (unsigned char *)malloc((size_t)head + 1);
   f->data = (unsigned char *)malloc(size ? (size_t)size : 1);
   if (!f->raw || !f->data) { ex_fail(error, path, "out of memory"); goto fail; }
   if (fread(f->raw, 1, (size_t)head, in) != head || fread(f->data, 1, (size_t)size, in) != size) { ex_fail(error, path, "cannot be read"); goto fail; }
   s.p = (const char *)f->raw;
   s.end = s.p + head;
   if (!take(&s, '{')) { ex_fail(error, path, "is no safetensors file: no JSON header"); goto fail; }
   for (; peek(&s) != '}'; first = 0) {
      char *name;
      if (!first && !take(&s, ',')) break;
      if (!(name = text(&s))) break;
      if (!take(&s, ':')) { free(name); break; }
      if (!strcmp(name, "__metadata__")) {
         free(name);
         if (f->meta) { s.wrong = "two __metadata__ blocks"; break; }
         if (!read_meta(f, &s)) break;
      } else {
         if (ex_tensors_find(f, name)) { ex_fail(error, path, "tensor %.80s occurs twice", name); free(name); goto fail; }
         if (!read_tensor(f, &s, name, size)) { ex_fail(error, path, "tensor %.80s: %s", f->tensors ? f->tensor[f->tensors - 1].name : "?", s.wrong); goto fail; }
      }
   }
   if (!s.wrong) { s.p++; if (peek(&s) || s.p < s.end) s.wrong = "something follows the header's closing brace"; }
   if (s.wrong) { ex_fail(error, path, "%s", s.wrong); goto fail; }
   fclose(in);
   return f;
fail:
   if (in) fclose(in);
   ex_tensors_close(f);
   return NULL;
}
void ex_tensors_close(ex_tensors *f)
{
   size_t i;
   if (!f) return;
   for (i = 0; i < f->tensors; i++) free((void *)(uintptr_t)f->tensor[i].name);
   for (i = 0; i < f->entries; i++) { free(f->meta[i].key); free(f->meta[i].value); }
   for (i = 0; i < f->moves; i++) free(f->moved[i]);
   free(f->tensor); free(f->meta); free(f->moved); free(f->raw); free(f->data); free(f->path);
   free(f);
}
size_t ex_tensors_count(const ex_tensors *f) { return f->tensors; }
const ex_tensor *ex_tensors_at(const ex_tensors *f, size_t i) { return i < f->tensors ? &f->tensor[i] : NULL; }
const char *ex_tensors_path(const ex_tensors *f) { return f->path; }
const ex_tensor *ex_tensors_find(const ex_tensors *f, const char *name)
{
   size_t i;
   for (i = 0; i < f->tensors; i++) if (!strcmp(f->tensor[i].name, name)) return &f->tensor[i];
   return NULL;
}
const char *ex_tensors_meta(const ex_tensors *f, const char *key)
{
   size_t i;
   for (i = 0; i < f->entries; i++) if (!strcmp(f->meta[i].key, key)) return f->meta[i].value;
   return NULL;
}
static const char *shape_text(size_t rank, const size_t *side, char *out, size_t room)
{
   size_t i, n = 0;
   n += (size_t)snprintf(out, room, "[");
   for (i = 0; i < rank && n + 24 < room; i++) {
      if (side[i]) n += (size_t)snprintf(out + n, room - n, "%s%lu", i ? "," : "", (unsigned long)side[i]);
      else n += (size_t)snprintf(out + n, room - n, "%s*", i ? "," : "");
   }
   snprintf(out + n, room - n, "]");
   return out;
}
const ex_tensor *ex_tensors_get(const ex_tensors *f, const char *name, size_t rank, const size_t *sides, char *error)
{
   const ex_tensor *t = ex_tensors_find(f, name);
   char want[96], have[96];
   size_t i;
   int same;
   if (!t) { ex_fail(error, f->path, "has no tensor %.60s", name); return NULL; }
   same = t->rank == rank;
   for (i = 0; same && i < rank; i++) same = !sides[i] || sides[i] == t->shape[i];
   if (same) return t;
   ex_fail(error, f->path, "%.40s is %s, expected %s", name, shape_text(t->rank, t->shape, have, sizeof have), shape_text(rank, sides, want, sizeof want));
   return NULL;
}
static double element(const ex_tensor *t, size_t i)
{
   switch (t->type) {
   case EX_F32: return (double)((const float *)t->data)[i];
   case EX_F64: return ((const double *)t->data)[i];
   case EX_I8:  return ((const int8_t *)t->data)[i];
   case EX_U16: return ((const uint16_t *)t->data)[i];
   case EX_I16: return ((const int16_t *)t->data)[i];
   case EX_U32: return ((const uint32_t *)t->data)[i];
   case EX_I32: return ((const int32_t *)t->data)[i];
   case EX_U64: return (double)((const uint64_t *)t->data)[i];
   case EX_I64: return (double)((const int64_t *)t->data)[i];
   case EX_BF16: {
      uint32_t u = (uint32_t)((const uint16_t *)t->data)[i] << 16;
      float v;
      memcpy(&v, &u, 4);
      return (double)v;
   }
   case EX_F16: { /* sign 1, exponent 5, fraction 10 */
      unsigned u = ((const uint16_t *)t->data)[i], e = u >> 10 & 31, m = u & 1023;
      double v = e == 31 ? (m ? (double)NAN : (double)INFINITY) : e ? ldexp(1024.0 + m, (int)e - 25) : ldexp((double)m, -24);
      return u & 0x8000 ? -v : v;
   }
   default: return ((const uint8_t *)t->data)[i]; /* U8, BOOL */
   }
}
void ex_tensor_f32(const ex_tensor *t, float *out)
{
   size_t i;
   if (t->type == EX_F32) { if (t->bytes) memcpy(out, t->data, t->bytes); return; }
   for (i = 0; i < t->count; i++) out[i] = (float)element(t, i);
}
int ex_tensor_u32(const ex_tensors *f, const ex_tensor *t, uint32_t *out, char *error)
{
   size_t i;
   for (i = 0; i < t->count; i++) {
      double v = element(t, i);
      if (!(v >= 0 && v <= 4294967295.0) || v != floor(v)) { ex_fail(error, f->path, "%.60s: element %lu is %g, not an index", t->name, (unsigned long)i, v); return 0; }
      out[i] = (uint32_t)v;
   }
   return 1;
}

/* ------------------------------------------------- writing */
typedef struct declared { char *name; ex_dtype type; size_t rank, shape[EX_MAX_RANK], count; uint64_t offset; } declared;
struct ex_writer {
   char *path, *part;            /* the final name, and "name.part" until everything is written */
   FILE *out;
   entry *meta;
   size_t entries;
   declared *tensor;
   size_t tensors;
   uint64_t start, total, at;    /* of the rows in the file; their bytes; where the file is now */
   int started, failed;          /* failed 1: writing, 2: memory, 3: caller */
};
ex_writer *ex_writer_open(const char *path, char *error)
{
   ex_writer *w = (ex_writer *)calloc(1, sizeof *w);
   size_t n = strlen(path);
   if (!w || !(w->path = copy_text(path)) || !(w->part = (char *)malloc(n + 6))) { ex_fail(error, path, "out of memory"); goto fail; }
   memcpy(w->part, path, n);
   memcpy(w->part + n, ".part", 6);
   w->out = fopen(w->part, "wb");
   if (!w->out) { ex_fail(error, path, "cannot be written"); goto fail; }
   return w;
fail:
   if (w) { free(w->path); free(w->part); }
   free(w);
   return NULL;
}
void ex_writer_meta(ex_writer *w, const char *key, const char *value)
{
   entry e, *list = (entry *)grow(w->meta, w->entries, sizeof *w->meta);
   if (w->started) { w->failed = 3; return; }
   if (!list) { w->failed = 2; return; }
   w->meta = list;
   e.key = copy_text(key);
   e.value = copy_text(value);
   if (!e.key || !e.value) { free(e.key); free(e.value); w->failed = 2; return; }
   w->meta[w->entries++] = e;
}
void ex_writer_metaf(ex_writer *w, const char *key, const char *format, ...)
{
   char value[512];
   va_list list;
   va_start(list, format);
   vsnprintf(value, sizeof value, format, list);
   va_end(list);
   ex_writer_meta(w, key, value);
}
size_t ex_writer_tensor(ex_writer *w, const char *name, ex_dtype type, size_t rank, const size_t *shape)
{
   declared d, *list = (declared *)grow(w->tensor, w->tensors, sizeof *w->tensor);
   size_t i;
   memset(&d, 0, sizeof d);
   if (list) w->tensor = list;
   if (w->started || rank > EX_MAX_RANK) { w->failed = 3; return 0; }
   if (!list || !(d.name = copy_text(name))) { w->failed = 2; return 0; }
   d.type = type;
   d.rank = rank;
   d.count = 1;
   for (i = 0; i < rank; i++) d.count *= d.shape[i] = shape[i];
   w->tensor[w->tensors] = d;
   return w->tensors++;
}
static void quote(char **o, const char *s) /* room is 6 bytes a character */
{
   char *p = *o;
   *p++ = '"';
   for (; *s; s++) {
      if (*s == '"' || *s == '\\') { *p++ = '\\'; *p++ = *s; }
      else if ((unsigned char)*s < 32) p += sprintf(p, "\\u%04x", (unsigned)(unsigned char)*s);
      else *p++ = *s;
   }
   *p++ = '"';
   *o = p;
}
static void start(ex_writer *w) /* header, with tensors laid out widest type first so that all are aligned */
{
   size_t i, k, room = 64, size;
   char *head, *o;
   unsigned char lead[8];
   if (w->started) return;
   w->started = 1;
   for (size = 8; size; size /= 2)
      for (i = 0; i < w->tensors; i++) if (ex_dtype_size(w->tensor[i].type) == size) {
         w->tensor[i].offset = w->total;
         w->total += (uint64_t)w->tensor[i].count * size;
      }
   for (i = 0; i < w->entries; i++) room += 6 * (strlen(w->meta[i].key) + strlen(w->meta[i].value)) + 16;
   for (i = 0; i < w->tensors; i++) room += 6 * strlen(w->tensor[i].name) + 128 + 24 * EX_MAX_RANK;
   head = o = (char *)malloc(room);
   if (!head) { w->failed = 2; return; }
   *o++ = '{';
   if (w->entries) {
      o += sprintf(o, "\"__metadata__\":{");
      for (i = 0; i < w->entries; i++) {
         if (i) *o++ = ',';
         quote(&o, w->meta[i].key);
         *o++ = ':';
         quote(&o, w->meta[i].value);
      }
      o += sprintf(o, "}%s", w->tensors ? "," : "");
   }
   for (size = 8, k = 0; size; size /= 2) /* the format wants the header in the order of the rows */
      for (i = 0; i < w->tensors; i++) {
         const declared *d = &w->tensor[i];
         size_t s;
         if (ex_dtype_size(d->type) != size) continue;
         if (k++) *o++ = ',';
         quote(&o, d->name);
         o += sprintf(o, ":{\"dtype\":\"%s\",\"shape\":[", ex_dtype_name(d->type));
         for (s = 0; s < d->rank; s++) o += sprintf(o, "%s%lu", s ? "," : "", (unsigned long)d->shape[s]);
         o += sprintf(o, "],\"data_offsets\":[%llu,%llu]}", (unsigned long long)d->offset, (unsigned long long)(d->offset + (uint64_t)d->count * size));
      }
   *o++ = '}';
   while ((o - head) % 8) *o++ = ' ';
   for (i = 0; i < 8; i++) lead[i] = (unsigned char)((uint64_t)(o - head) >> (8 * i));
   if (fwrite(lead, 1, 8, w->out) != 8 || fwrite(head, 1, (size_t)(o - head), w->out) != (size_t)(o - head)) w->failed = 1;
   w->start = w->at = 8 + (uint64_t)(o - head);
   free(head);
   if (w->total && !w->failed) { /* the full length at once: what is never put is zero */
      if (fseek(w->out, (long)(w->start + w->total - 1), SEEK_SET) || fputc(0, w->out) == EOF) w->failed = 1;
      w->at = w->start + w->total;
   }
}
void ex_writer_put(ex_writer *w, size_t id, size_t first, const void *data, size_t count)
{
   const declared *d;
   uint64_t where;
   size_t size;
   start(w);
   if (w->failed) return;
   if (id >= w->tensors || first > w->tensor[id].count || count > w->tensor[id].count - first) { w->failed = 3; return; }
   d = &w->tensor[id];
   size = ex_dtype_size(d->type);
   where = w->start + d->offset + (uint64_t)first * size;
   if (where != w->at && fseek(w->out, (long)where, SEEK_SET)) { w->failed = 1; return; }
   if (count && fwrite(data, size, count, w->out) != count) { w->failed = 1; return; }
   w->at = where + (uint64_t)count * size;
}
int ex_writer_close(ex_writer *w, char *error)
{
   size_t i;
   int failed;
   start(w);
   if (fclose(w->out) && !w->failed) w->failed = 1;
   if (!w->failed) {
      remove(w->path);  /* rename does not replace a file everywhere */
      if (rename(w->part, w->path)) w->failed = 1;
   }
   failed = w->failed;
   if (failed) {
      remove(w->part);
      ex_fail(error, w->path, "%s", failed == 1 ? "cannot be written (disk full?)" : failed == 2 ? "out of memory" : "written wrongly by the program: tensor id, range or order");
   }
   for (i = 0; i < w->entries; i++) { free(w->meta[i].key); free(w->meta[i].value); }
   for (i = 0; i < w->tensors; i++) free(w->tensor[i].name);
   free(w->meta); free(w->tensor); free(w->path); free(w->part);
   free(w);
   return !failed;
}
