/*  mesh.c - see mesh.h: the OBJ reader, and what is checked whatever the file */
#include "mesh.h"
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void ex_mesh_free(ex_mesh *m)
{
   if (!m) return;
   free(m->positions); free(m->normals); free(m->uv); free(m->triangle);
   free(m);
}

/* ------------------------------------------------- OBJ */
typedef struct rows { float *at; size_t count, room, width; } rows;
static int rows_add(rows *r, const double *v)
{
   size_t k;
   if (r->count == r->room) {
      size_t room = r->room ? 2 * r->room : 1024;
      float *at = room > SIZE_MAX / 16 ? NULL : (float *)realloc(r->at, room * r->width * sizeof *at);
      if (!at) return 0;
      r->at = at;
      r->room = room;
   }
   for (k = 0; k < r->width; k++) r->at[r->count * r->width + k] = (float)v[k];
   r->count++;
   return 1;
}
typedef struct obj {
   const char *path, *p, *end;   /* the text that is left; *end is 0 */
   size_t line;
   rows v, t, n;                 /* positions, texture coordinates, normals of the file */
   uint32_t (*corner)[3];        /* (corners) their numbers + 1; 0: not given */
   size_t corners, room;
   char *error;
} obj;
static int blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }
static void skip_blanks(obj *o) { while (blank(*o->p)) o->p++; }
static int at_end(const obj *o) { return *o->p == 0 || *o->p == '\n' || *o->p == '#'; }

/* a decimal number, whatever the locale says of commas */
static int read_number(obj *o, double *out)
{
   double value = 0, sign = 1;
   int digits = 0, power = 0, e = 0, minus = 0;
   skip_blanks(o);
   if (*o->p == '-' || *o->p == '+') sign = *o->p++ == '-' ? -1 : 1;
   for (; *o->p >= '0' && *o->p <= '9'; o->p++, digits++) value = value * 10 + (*o->p - '0');
   if (*o->p == '.') for (o->p++; *o->p >= '0' && *o->p <= '9'; o->p++, digits++) { value = value * 10 + (*o->p - '0'); power--; }
   if (!digits || digits > 300) return 0;
   if (*o->p == 'e' || *o->p == 'E') {
      o->p++;
      if (*o->p == '-' || *o->p == '+') minus = *o->p++ == '-';
      if (!(*o->p >= '0' && *o->p <= '9')) return 0;
      for (; *o->p >= '0' && *o->p <= '9'; o->p++) e = e < 10000 ? 10 * e + (*o->p - '0') : e;
      power += minus ? -e : e;
   }
   *out = sign * value * pow(10.0, power);
   return isfinite(*out) && fabs(*out) < 1e30;
}
/* one number of "a/b/c": from 1, or from -1 backwards; 0 with *good: not given */
static uint32_t read_index(obj *o, size_t count, int *good)
{
   int minus = *o->p == '-';
   size_t i = 0;
   if (minus) o->p++;
   if (!(*o->p >= '0' && *o->p <= '9')) { *good = !minus; return 0; }
   for (; *o->p >= '0' && *o->p <= '9'; o->p++) i = i < 0x10000000 ? 10 * i + (size_t)(*o->p - '0') : i;
   *good = i >= 1 && i <= count;
   return (uint32_t)(minus ? count + 1 - i : i);
}
static int bad_line(obj *o, const char *what) { return ex_fail(o->error, o->path, "line %lu: %s", (unsigned long)o->line, what); }

static int read_face(obj *o)
{
   uint32_t first[3] = {0, 0, 0}, last[3] = {0, 0, 0};
   size_t n = 0;
   for (skip_blanks(o); !at_end(o); skip_blanks(o), n++) {
      uint32_t c[3] = {0, 0, 0};
      const rows *list[3];
      int k, good;
      list[0] = &o->v; list[1] = &o->t; list[2] = &o->n;
      for (k = 0; k < 3; k++) {
         c[k] = read_index(o, list[k]->count, &good);
         if (!good || (k == 0 && !c[0])) return bad_line(o, k == 0 ? "a face names a vertex that is not there" : k == 1 ? "a face names a texture coordinate that is not there" : "a face names a normal that is not there");
         if (*o->p != '/') break;
         o->p++;
      }
      if (k == 3 || !(at_end(o) || blank(*o->p))) return bad_line(o, "a corner of a face is not v, v/t, v//n or v/t/n");
      if (n == 0) memcpy(first, c, sizeof c);
      if (n >= 2) {
         if (o->corners + 3 > o->room) {
            size_t room = o->room ? 2 * o->room : 3072;
            void *at = room > SIZE_MAX / 32 ? NULL : realloc(o->corner, room * sizeof *o->corner);
            if (!at) return ex_fail(o->error, o->path, "out of memory");
            o->corner = (uint32_t (*)[3])at;
            o->room = room;
            if (room > 0x7fffffff) return ex_fail(o->error, o->path, "has too many faces");
         }
         memcpy(o->corner[o->corners++], first, sizeof c);
         memcpy(o->corner[o->corners++], last, sizeof c);
         memcpy(o->corner[o->corners++], c, sizeof c);
      }
      memcpy(last, c, sizeof c);
   }
   return n >= 3 ? 1 : bad_line(o, "a face has fewer than three corners");
}
static int read_lines(obj *o)
{
   for (o->line = 1; *o->p; o->line++) {
      double v[3] = {0, 0, 0};
      rows *list = NULL;
      size_t k, least = 3;
      skip_blanks(o);
      if (o->p[0] == 'v' && blank(o->p[1])) { list = &o->v; o->p++; }
      else if (o->p[0] == 'v' && o->p[1] == 't' && blank(o->p[2])) { list = &o->t; least = 1; o->p += 2; }
      else if (o->p[0] == 'v' && o->p[1] == 'n' && blank(o->p[2])) { list = &o->n; o->p += 2; }
      if (list) {
         for (k = 0; k < list->width && (skip_blanks(o), !at_end(o)); k++) if (!read_number(o, v + k)) return bad_line(o, "is not a list of numbers");
         if (k < least) return bad_line(o, "has too few numbers");
         if (list->count >= 0x0fffffff || !rows_add(list, v)) return ex_fail(o->error, o->path, "has too many vertices");
      } else if (o->p[0] == 'f' && blank(o->p[1])) {
         o->p++;
         if (!read_face(o)) return 0;
      }
      while (*o->p && *o->p != '\n') o->p++;
      if (*o->p) o->p++;
   }
   if (o->p < o->end) return bad_line(o, "has a zero byte: not a text");
   if (!o->corners) return ex_fail(o->error, o->path, "has no faces");
   return 1;
}
/* each combination of numbers becomes a vertex, by first appearance */
static int join(obj *o, ex_mesh *m)
{
   size_t room = 64, i, k, slot;
   uint32_t *table, *of;
   int with[3] = {1, 1, 1}, ok = 0;
   while (room < 2 * o->corners) room *= 2;
   table = (uint32_t *)malloc(room * sizeof *table); /* corner + 1 that a slot's vertex first appeared at */
   of = (uint32_t *)malloc(o->corners * sizeof *of); /* its vertex */
   for (i = 0; i < o->corners; i++) for (k = 1; k < 3; k++) if (!o->corner[i][k]) with[k] = 0;
   for (i = 0; i < o->corners; i++) for (k = 1; k < 3; k++) if (!with[k]) o->corner[i][k] = 0;
   m->triangles = o->corners / 3;
   m->positions = (float *)malloc(3 * o->corners * sizeof(float));
   m->normals = with[2] ? (float *)malloc(3 * o->corners * sizeof(float)) : NULL;
   m->uv = with[1] ? (float *)malloc(2 * o->corners * sizeof(float)) : NULL;
   m->triangle = (uint32_t *)malloc(o->corners * sizeof *m->triangle);
   if (!table || !of || !m->positions || !m->triangle || (with[2] && !m->normals) || (with[1] && !m->uv)) { ex_fail(o->error, o->path, "out of memory"); goto end; }
   memset(table, 0, room * sizeof *table);
   for (i = 0; i < o->corners; i++) {
      const uint32_t *c = o->corner[i];
      uint64_t h = c[0] * 0x9e3779b97f4a7c15u ^ c[1] * 0xc2b2ae3d27d4eb4fu ^ c[2] * 0x165667b19e3779f9u;
      for (slot = (size_t)(h >> 20) & (room - 1); table[slot] && memcmp(o->corner[table[slot] - 1], c, sizeof o->corner[0]); slot = (slot + 1) & (room - 1)) {}
      if (!table[slot]) {
         table[slot] = (uint32_t)i + 1;
         of[i] = (uint32_t)m->vertices;
         memcpy(m->positions + 3 * m->vertices, o->v.at + 3 * (size_t)(c[0] - 1), 12);
         if (m->normals) memcpy(m->normals + 3 * m->vertices, o->n.at + 3 * (size_t)(c[2] - 1), 12);
         if (m->uv) {
            m->uv[2 * m->vertices] = o->t.at[2 * (size_t)(c[1] - 1)];
            m->uv[2 * m->vertices + 1] = 1 - o->t.at[2 * (size_t)(c[1] - 1) + 1]; /* OBJ counts from the bottom */
         }
         m->vertices++;
      } else of[i] = of[table[slot] - 1];
      m->triangle[i] = of[i];
   }
   ok = 1;
end:
   free(table);
   free(of);
   return ok;
}
static char *read_text(const char *path, size_t *size, char *error)
{
   FILE *f = fopen(path, "rb");
   char *text = NULL;
   size_t n = 0, room = 0, got;
   if (!f) { ex_fail(error, path, "cannot be opened: %s", strerror(errno)); return NULL; }
   do {
      if (room - n < 2) {
         char *t = (char *)realloc(text, room = room ? 2 * room : (size_t)1 << 16);
         if (!t) { free(text); fclose(f); ex_fail(error, path, "out of memory"); return NULL; }
         text = t;
      }
      got = fread(text + n, 1, room - n - 1, f);
      n += got;
   } while (got);
   fclose(f);
   text[n] = 0;
   *size = n;
   return text;
}
static ex_mesh *obj_mesh(const char *path, char *error)
{
   ex_mesh *m = (ex_mesh *)calloc(1, sizeof *m);
   size_t size = 0;
   char *text = m ? read_text(path, &size, error) : NULL;
   obj o;
   int ok = 0;
   if (!m) ex_fail(error, path, "out of memory");
   if (text) {
      memset(&o, 0, sizeof o);
      o.path = path; o.p = text; o.end = text + size; o.error = error;
      o.v.width = o.n.width = 3;
      o.t.width = 2;
      ok = read_lines(&o) && join(&o, m);
      free(o.v.at); free(o.t.at); free(o.n.at); free(o.corner);
   }
   free(text);
   if (!ok) { ex_mesh_free(m); m = NULL; }
   return m;
}

/* ------------------------------------------------- any file */
static int mesh_ends_with(const char *s, const char *end)
{
   size_t n = strlen(s), m = strlen(end), i;
   if (n < m) return 0;
   for (i = 0; i < m; i++) {
      char c = s[n - m + i];
      if ((c >= 'A' && c <= 'Z' ? c + 32 : c) != end[i]) return 0;
   }
   return 1;
}
static int mesh_finish(ex_mesh *m, const char *path, char *error)
{
   size_t i, k;
   if (!m->vertices || !m->triangles) return ex_fail(error, path, "has no triangles");
   if (m->vertices > 0x7fffffff) return ex_fail(error, path, "has too many vertices");
   for (i = 0; i < 3 * m->vertices; i++) if (!(fabsf(m->positions[i]) < 1e9f)) return ex_fail(error, path, "position of vertex %lu is %g", (unsigned long)(i / 3), (double)m->positions[i]);
   for (i = 0; i < 3 * m->triangles; i++) if (m->triangle[i] >= m->vertices) return ex_fail(error, path, "triangle %lu names vertex %lu of %lu", (unsigned long)(i / 3), (unsigned long)m->triangle[i], (unsigned long)m->vertices);
   for (i = 0; m->uv && i < 2 * m->vertices; i++) if (!(fabsf(m->uv[i]) < 1e9f)) m->uv[i] = 0;
   for (i = 0; m->normals && i < m->vertices; i++) { /* unit ones, or none at all */
      float *n = m->normals + 3 * i;
      double l = sqrt((double)n[0] * (double)n[0] + (double)n[1] * (double)n[1] + (double)n[2] * (double)n[2]);
      if (!(l > 1e-6 && l < 1e6)) { free(m->normals); m->normals = NULL; break; }
      for (k = 0; k < 3; k++) n[k] = (float)((double)n[k] / l);
   }
   return 1;
}
ex_mesh *ex_mesh_load(const char *path, char *error)
{
   ex_mesh *m = NULL;
   if (mesh_ends_with(path, ".obj")) m = obj_mesh(path, error);
   else if (mesh_ends_with(path, ".glb") || mesh_ends_with(path, ".gltf")) m = ex__gltf_mesh(path, error);
   else ex_fail(error, path, "is neither .obj, .glb nor .gltf");
   if (m && !mesh_finish(m, path, error)) { ex_mesh_free(m); m = NULL; }
   return m;
}
#ifndef EX_TINYGLTF
ex_mesh *ex__gltf_mesh(const char *path, char *error)
{
   ex_fail(error, path, "reading glTF needs tinygltf: apt-get install libtinygltf-dev");
   return NULL;
}
#endif
