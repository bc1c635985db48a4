/*  flesh.h - what the parts of the truth solver share; flesh.c is the program and says what it is for

    flow      ex_scene --flesh_rest.c--> welded mesh, parts, limbs, rigid ends
              --flesh_lattice.c--> cells and nodes, glued per part; vertices embedded in cells
              --flesh_bones.c--> springs from nodes to bones       --flesh_solve.c--> factorised elastic system
              palettes of a frame --flesh_solve.c--> node positions --flesh_surface.c--> vertices, figures
    sharing   a body is built once and only read afterwards, so that threads share it; everything that a pose
              writes is in a solver, one for each thread
    space     the rest mesh scaled to metres ("work space"): the file's unit and the scale of its palettes are
              divided out, so that every length below is in metres on a body of human size
    words     V, S as in scene.h; N welded vertices; P parts: joints after fingers have joined their hand and so
              on; C cells; M nodes */
#ifndef FLESH_H
#define FLESH_H
#include "../common/scene.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct vec { double x, y, z; } vec;
typedef struct quat { double w, x, y, z; } quat;

typedef struct flesh_options {
   double cell;       /* edge of a lattice cell, m */
   double nu;         /* Poisson's ratio: near 0.5 keeps volume */
   double self;       /* m along the body within which flesh does not touch itself */
   double bone;       /* spring of a node on a bone axis, in cell edges of stiffness mu h */
   double bonerad;    /* bones end at this fraction of the way from axis to skin */
   double rigid;      /* spring of hands, head and feet to plain skinning */
   double tether;     /* weak spring of every node to plain skinning, so that nothing floats */
   double hourglass;  /* stiffness against the zig-zag that one quadrature point per cell does not see */
   double contact;    /* stiffness of contact */
   double thick;      /* m that touching skin keeps apart */
   double w;          /* weight of the elastic Laplacian in L-BFGS's initial Hessian */
   int cells;         /* where about more would be needed, cells are larger */
   int iters;         /* most iterations a pose */
   int refresh;       /* iterations between searches for contacts */
   int frozen;        /* further iterations, with the contacts held, for a pose that has not settled */
   int mush;          /* smoothing passes that hide the cells */
   int memory;        /* pairs that L-BFGS keeps, at most 64 */
   int chain;         /* frames that start from one another; each chain starts from plain skinning */
   int names;         /* 0: find hands, head, feet and limbs from geometry alone */
   double bar;        /* mm: a pose whose last step was longer has not settled */
   int verbose;
} flesh_options;

typedef struct cell {
   int x, y, z, next;   /* place in the grid; next instance in the same place */
   int inside;          /* not touched by the surface */
   float count;         /* surface samples averaged into p and n */
   vec p, n;
   int node[8], link[6];/* corners, bit 0 x, bit 1 y, bit 2 z; glued neighbour +x -x +y -y +z -z or -1 */
   int nearest;         /* vertex nearest to the centre, reached through links, or -1 */
   double vol;          /* filled fraction */
} cell;
typedef struct bone { int j, c; double t, a, b; } bone; /* from joint j to c; where along it; distances to both ends */

typedef struct body {
   const ex_scene *scene;
   flesh_options o;
   double unit, rest;        /* metres = unit * model units = rest * mesh units */
   /* welded mesh */
   int vertices, triangles;  /* N, T */
   int *of;                  /* (V) welded vertex of each of the file's */
   vec *pos, *nrm;           /* (N) rest */
   int (*tri)[3];            /* (T) */
   int influences;           /* I */
   int *vj;                  /* (N,I) joints */
   float *vweight;           /* (N,I) sum 1 */
   int *adj0, *adj;          /* one-rings, each neighbour twice inside the mesh */
   double *area;             /* (N) */
   /* skeleton */
   int joints, parts;        /* S, P */
   int *parent, *group;      /* (S) group: the joint whose rigid end this one belongs to, or itself */
   int *part;                /* (S) part of the joint's group, -1 when no skin hangs on it */
   int *part_joint;          /* (P) */
   char *end, *limb, *twist; /* (S) rigid end; limb bone; limb bone before a rigid end */
   char *alive;              /* (S) some skin hangs on it or below it */
   vec *joint;               /* (S) rest */
   double *radius;           /* (S) of the limb around the joint */
   /* lattice */
   double h;
   vec org;
   int nx, ny, nz, *grid;    /* first cell of each place, or -1 */
   int cells, cell_room;
   cell *cell;
   float *cw;                /* (C,P) */
   int nodes;                /* M */
   vec *x;                   /* (M) rest */
   float *nw;                /* (M,P) */
   int *shell;               /* (M) more than two cells from any interior cell: loose cloth */
   int *vc;                  /* (N) cell that carries the vertex, -1: none */
   float (*vw)[8];           /* (N) its trilinear weights */
   float *beta;              /* (N) 1: plain skinning (hands, head, feet) */
   /* springs */
   bone *nb;                 /* (M) */
   double *kb, *kr, *kt;     /* (M) to the bone, to the rigid end, to plain skinning */
   int *rj;                  /* (M) joint of the rigid end */
   /* constant system, skyline Cholesky */
   double mu, lambda;
   int *perm, *first;
   size_t *row;
   float *L;
   /* contact */
   int *cvert, cverts;       /* vertices tested, one for each eighth of a cell */
   double *carea;
   int *near0, *near;        /* (C+1), cells of the own neighbourhood, ascending */
   /* surface */
   vec *mush;                /* (N) detail in the smoothed mesh's frame */
   char *crossed;            /* (N) crosses in the rest mesh already */
   int edges, *edge;         /* (E,2) */
} body;

typedef struct contact { int p, q; vec n; double k, off; } contact; /* keep (x_p - x_q).n >= off */

typedef struct figures {
   float volume, stretch, step_mm, energy, deepest_mm;
   double seconds;
   int crossings_before, crossings_after, iterations, evaluations, contacts, settled;
} figures;

typedef struct solver {
   const body *b;
   double *A;                /* (S,12) palettes in work space */
   quat *q;                  /* (S) their rotations */
   vec *p;                   /* (S) posed joints */
   vec *target, *plain;      /* (M) of the springs; plain skinning of the nodes */
   double *k;                /* (M) kb + kr */
   double *x, *g, *g2, *d, *x2, *ls, *ly; /* (3M); ls, ly (memory,3M) */
   float *s;                 /* (3M) for the triangular solves */
   vec *off;                 /* (M) result of the last pose, in its nodes' frames */
   contact *con;
   int cons, con_room;
   double deepest;
   vec *skin, *normal, *tmp, *out, *lbs; /* (N) */
   int *head, *next, *who, hash_room; /* spatial hash */
} solver;

void *flesh_zalloc(size_t count, size_t size); /* zeroed; ends the program when memory runs out */
void *flesh_grow(void *list, size_t count, size_t size);
void flesh_die(const char *format, ...);
#define NEW(type, n) ((type *)flesh_zalloc((size_t)(n), sizeof(type)))

void flesh_rest(body *b, const ex_scene *s);                 /* flesh_rest.c */
void flesh_lattice(body *b);                                 /* flesh_lattice.c */
vec flesh_centre(const body *b, const cell *c);
void flesh_part_weights(const body *b, int v, float *w);     /* (P) */
void flesh_bones(body *b);                                   /* flesh_bones.c */
vec flesh_bone_target(const solver *s, const bone *t, vec x);
quat flesh_node_rotation(const solver *s, int node);
void flesh_system(body *b);                                  /* flesh_solve.c */
void flesh_contacts(body *b);
solver *flesh_solver(const body *b);
void flesh_solver_free(solver *s);
void flesh_solve(solver *s, const float *palette, int restart, float *out, figures *f); /* out (V,3), the file's units */
vec flesh_embed(const body *b, const double *x, int v);
void flesh_surface(body *b);                                 /* flesh_surface.c */
void flesh_normals(const body *b, const vec *p, vec *n);
void flesh_smooth(const body *b, vec *p, vec *tmp, vec *n, vec *work);
int flesh_crossings(solver *s, const vec *p, char *crossed); /* crossed (N) may be NULL */
double flesh_stretch(const body *b, const vec *p);

/* ------------------------------------------------- small vectors */
static inline vec vmake(double x, double y, double z) { vec r; r.x = x; r.y = y; r.z = z; return r; }
static inline vec vadd(vec a, vec b) { return vmake(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline vec vsub(vec a, vec b) { return vmake(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline vec vmul(vec a, double s) { return vmake(a.x * s, a.y * s, a.z * s); }
static inline double vdot(vec a, vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline vec vcross(vec a, vec b) { return vmake(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }
static inline double vlen(vec a) { return sqrt(vdot(a, a)); }
static inline vec vunit(vec a) { double l = vlen(a); return l > 1e-20 ? vmul(a, 1 / l) : vmake(0, 0, 0); }
static inline vec vmin(vec a, vec b) { return vmake(a.x < b.x ? a.x : b.x, a.y < b.y ? a.y : b.y, a.z < b.z ? a.z : b.z); }
static inline vec vmax(vec a, vec b) { return vmake(a.x > b.x ? a.x : b.x, a.y > b.y ? a.y : b.y, a.z > b.z ? a.z : b.z); }
static inline double clampd(double x, double a, double b) { return x < a ? a : x > b ? b : x; }
static inline double smooth(double a, double b, double x) { x = clampd((x - a) / (b - a), 0, 1); return x * x * (3 - 2 * x); }
static inline quat qmul(quat a, quat b)
{
   quat r;
   r.w = a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z;
   r.x = a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y;
   r.y = a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x;
   r.z = a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w;
   return r;
}
static inline quat qconj(quat a) { a.x = -a.x; a.y = -a.y; a.z = -a.z; return a; }
static inline quat qnorm(quat a)
{
   double l = sqrt(a.w * a.w + a.x * a.x + a.y * a.y + a.z * a.z);
   quat one = {1, 0, 0, 0};
   if (!(l > 1e-12)) return one;
   a.w /= l; a.x /= l; a.y /= l; a.z /= l;
   return a;
}
static inline vec qrot(quat q, vec v)
{
   vec u = vmake(q.x, q.y, q.z), t = vmul(vcross(u, v), 2);
   return vadd(vadd(v, vmul(t, q.w)), vcross(u, t));
}
/* where joint j's palette A (S,12) carries x */
static inline vec carry(const double *A, int j, vec x)
{
   const double *m = A + 12 * (size_t)j;
   return vmake(m[0] * x.x + m[1] * x.y + m[2] * x.z + m[3], m[4] * x.x + m[5] * x.y + m[6] * x.z + m[7], m[8] * x.x + m[9] * x.y + m[10] * x.z + m[11]);
}
#endif
