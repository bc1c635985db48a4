/*  flesh_bones.c - springs that tie the flesh to the skeleton

    in        body with lattice; in a pose: the joints' posed places and rotations
    bone      a node near the axis of a bone follows the *bone field*: rigid along the bone, half-way between two
              bones at the joint they share, and along a limb the twist grows from one end to the other instead of
              jumping at the wrist (what twist bones do in a rig)
    end       nodes of hands, head and feet follow plain skinning
    tether    every node follows plain skinning a little, loose cloth more */
#include "flesh.h"

static float weight(const body *b, const float *w, int joint) { return b->part[joint] < 0 || b->group[joint] != joint ? 0 : w[b->part[joint]]; }
/* the limb's radius around a joint: mean distance of the skin that both of its bones share */
static void radii(body *b)
{
   float *w = NEW(float, b->parts);
   int j, i;
   b->radius = NEW(double, b->joints);
   for (j = 0; j < b->joints; j++) {
      double sum = 0;
      int n = 0, up = b->parent[j];
      if (up >= 0 && b->group[j] == j) for (i = 0; i < b->vertices; i++) {
         flesh_part_weights(b, i, w);
         if (weight(b, w, up) > .25f && weight(b, w, j) > .25f) { sum += vlen(vsub(b->pos[i], b->joint[j])); n++; }
      }
      b->radius[j] = n > 8 ? clampd(0.8 * sum / n, 0.02, 0.09) : 0.035;
   }
   free(w);
}
void flesh_bones(body *b)
{
   double unit = b->h; /* mu is 1 a volume: a stiffness of mu h is "one cell edge" */
   int n, i, j, c, p, M = b->nodes;
   b->nb = NEW(bone, M);
   b->kb = NEW(double, M); b->kr = NEW(double, M); b->kt = NEW(double, M);
   b->rj = NEW(int, M);
   radii(b);
   for (n = 0; n < M; n++) {
      const float *w = b->nw + (size_t)n * (size_t)b->parts;
      double depth = 1e9, heaviest = 0, closest = 1e9;
      int best = -1;
      for (i = 0; i < b->vertices; i++) { vec d = vsub(b->pos[i], b->x[n]); double q = vdot(d, d); if (q < depth) depth = q; }
      depth = sqrt(depth);
      b->kt[n] = (b->shell[n] ? 50 : 1) * b->o.tether * unit;
      for (p = 0; p < b->parts; p++) if (b->end[b->part_joint[p]] && (double)w[p] > heaviest) { heaviest = w[p]; best = b->part_joint[p]; }
      b->rj[n] = best;
      b->kr[n] = b->o.rigid * unit * smooth(0.6, 0.95, heaviest);
      for (c = 0; c < b->joints; c++) { /* the nearest bone among those that move this node */
         vec e, r;
         double L, t, d;
         bone k;
         j = b->parent[c];
         if (j < 0 || b->group[j] != j || b->group[c] != c || !b->alive[c]) continue;
         for (i = j; i >= 0 && (b->part[i] < 0); i = b->parent[i]) {}
         if (i < 0) continue; /* from a root between the feet to the hips is no bone */
         if (weight(b, w, j) + weight(b, w, c) < 0.3f) continue;
         e = vsub(b->joint[c], b->joint[j]);
         r = vsub(b->x[n], b->joint[j]);
         t = clampd(vdot(r, e) / (vdot(e, e) + 1e-12), 0, 1);
         L = vlen(e);
         d = vlen(vsub(r, vmul(e, t)));
         if (d >= closest) continue;
         closest = d;
         k.j = j; k.c = c; k.t = t; k.a = t * L; k.b = (1 - t) * L;
         b->nb[n] = k;
      }
      if (closest < 1e8) b->kb[n] = b->o.bone * unit * (1 - smooth(0.5 * b->o.bonerad, b->o.bonerad, closest / (closest + depth + 1e-9)));
   }
}

/* ------------------------------------------------- in a pose */
static quat slerp(quat a, quat b, double t)
{
   double d = a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z, s = 1, ka = 1 - t, kb = t;
   quat r;
   if (d < 0) { d = -d; s = -1; }
   if (d < 0.9999) { double o = acos(d); ka = sin((1 - t) * o) / sin(o); kb = sin(t * o) / sin(o); }
   r.w = ka * a.w + s * kb * b.w; r.x = ka * a.x + s * kb * b.x; r.y = ka * a.y + s * kb * b.y; r.z = ka * a.z + s * kb * b.z;
   return qnorm(r);
}
static double twist(quat q, vec u) /* q's signed angle about the unit axis u (swing-twist) */
{
   const double pi = 3.14159265358979323846;
   double a = 2 * atan2(q.x * u.x + q.y * u.y + q.z * u.z, q.w);
   return a > pi ? a - 2 * pi : a < -pi ? a + 2 * pi : a;
}
/* rotation of bone j->c at t along it */
static quat bone_rotation(const solver *s, int j, int c, double t)
{
   const body *b = s->b;
   quat q = s->q[j], r;
   vec u = vunit(vsub(b->joint[c], b->joint[j]));
   double a = 0;
   if (b->limb[j] && b->parent[j] >= 0) a -= (1 - t) * twist(qmul(qconj(s->q[b->parent[j]]), s->q[j]), u);
   if (b->twist[j]) a += t * twist(qmul(qconj(s->q[j]), s->q[c]), u);
   if (a == 0) return q;
   r.w = cos(a / 2); r.x = u.x * sin(a / 2); r.y = u.y * sin(a / 2); r.z = u.z * sin(a / 2);
   return qmul(q, r);
}
/* where the bone field carries the rest point x */
vec flesh_bone_target(const solver *s, const bone *t, vec x)
{
   const body *b = s->b;
   int j = t->j, c = t->c, up = b->parent[j], k;
   quat q = bone_rotation(s, j, c, t->t);
   double L = t->a + t->b, r;
   if (t->a <= t->b || b->end[c]) { /* nearer to its own joint */
      r = fmin(b->radius[j], 0.5 * L);
      if (up >= 0 && t->a < r) q = slerp(bone_rotation(s, up, j, 1), q, 0.5 + 0.5 * t->a / r);
      return vadd(s->p[j], qrot(q, vsub(x, b->joint[j])));
   }
   r = fmin(b->radius[c], 0.5 * L);
   if (t->b < r) {
      quat next = s->q[c];
      for (k = c + 1; k < b->joints && b->parent[k] != c; k++) {}
      if (k < b->joints && b->limb[c]) next = bone_rotation(s, c, k, 0);
      q = slerp(next, q, 0.5 + 0.5 * t->b / r);
   }
   return vadd(s->p[c], qrot(q, vsub(x, b->joint[c])));
}
/* blended rotation of a node: the frame in which one pose's result is carried to the next */
quat flesh_node_rotation(const solver *s, int node)
{
   const body *b = s->b;
   const float *w = b->nw + (size_t)node * (size_t)b->parts;
   quat r = {0, 0, 0, 0}, ref;
   int p, most = 0;
   for (p = 1; p < b->parts; p++) if (w[p] > w[most]) most = p;
   ref = s->q[b->part_joint[most]];
   for (p = 0; p < b->parts; p++) if (w[p] > 0) {
      quat q = s->q[b->part_joint[p]];
      double k = q.w * ref.w + q.x * ref.x + q.y * ref.y + q.z * ref.z < 0 ? -w[p] : w[p];
      r.w += k * q.w; r.x += k * q.x; r.y += k * q.y; r.z += k * q.z;
   }
   return qnorm(r);
}
