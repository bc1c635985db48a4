/*  made.h - networks with random weights and meshes of any size, made in memory, for measuring

    networks  at the papers' sizes (spec: networks.md, section 5), as the bytes of a .safetensors file. Batch norm is left
              out: packing folds it away. Weights keep numbers near one through all layers, so that nothing is timed
              that only zeros, overflows or denormal numbers would show
    mesh      a closed ring of a x b vertices around S joints, four influences a vertex; every vertex has six neighbours
    random    the same on every machine for the same seed */
#ifndef EX_MADE_H
#define EX_MADE_H
#include <stddef.h>
#include <stdint.h>

/*  arch "mlp", "gat", "neuroskinning", "densegats", "multiresgnet" or "clothnet"; pooling "dynamic" or "rest"; joints S
    named joint0 .. NULL: unknown arch or out of memory. Give the bytes back with free */
unsigned char *ex_made_model(const char *arch, const char *pooling, size_t joints, size_t *size);

typedef struct ex_made {
   size_t vertices, triangles, joints, around, about;
   float *positions;        /* (V,3) */
   uint32_t *triangle;      /* (T,3) */
   uint32_t *skin_joints;   /* (V,4) */
   float *skin_weights;     /* (V,4) */
   float *inverse_bind;     /* (S,12) */
   float *palette;          /* (S,12) every joint turned a little about its place */
   float *geodesic;         /* (V,S) straight distances, which stand in for geodesic ones: see dn_rig_desc */
} ex_made;
/*  about `vertices` of them, at least 12; thick: radius of the ring's tube over that of its core; order by rows, or shuffled */
ex_made *ex_made_mesh(size_t vertices, size_t joints, double thick, int shuffle);
/*  another palette (S,12) for it */
void ex_made_pose(const ex_made *m, unsigned number, float *palette);
void ex_made_free(ex_made *m); /* NULL is allowed */

#endif
