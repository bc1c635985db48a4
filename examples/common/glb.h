/*  glb.h - GLB files out, for the examples: baked frames, and rigged characters
    shows     the container (header, JSON, binary chunk), accessors, sparse accessors, morph targets, skins, animation
    not here  reading glTF (scene_gltf.cc), textures
    checked   by Khronos' gltf-validator: no errors, no warnings (tests/rig.sh)
    errors    0 and one line in error[EX_ERROR]; a file that could not be finished is removed */
#ifndef EX_GLB_H
#define EX_GLB_H
#include "tensors.h"

#ifdef __cplusplus
extern "C" {
#endif

/*  ex_write_glb - baked frames as an animation that any viewer plays

    One mesh with the first frame as its shape and one morph target for each further frame; the weights move
    linearly from frame to frame. Offsets are stored as they are (float32), so a frame is exact.
    frames    F; positions (F,V,3); normals (F,V,3) or NULL: computed; times (F) ascending, seconds
    size      about 24 F V bytes */
typedef struct ex_baked {
   const char *name;              /* of mesh and animation */
   size_t vertices, triangles, frames;
   const uint32_t *triangle;
   const float *positions, *normals, *times;
} ex_baked;
int ex_write_glb(const char *path, const ex_baked *baked, char *error);

/*  ex_write_rig - a skinned character with morph targets and an animation of joints and morph weights

    skin      influences a multiple of 4: one JOINTS_n, WEIGHTS_n pair for every four. Rows sum to one within rounding;
              a joint with weight 0 is written as 0
    joints    rest rotations are the identity, so an inverse bind matrix is the translation by minus joint_rest
    targets   offsets of the vertices that a target moves. Written sparse, or dense where nearly all move; targets that
              follow one another with the same list `at` share its indices
    frames    0: no animation. Linear between keys
    size      bytes of a target: 12 a moved vertex, and 2 (4 from 65,536 vertices) once a list; 12 V if dense.
              Animation: 4 F (1 + 3 + 4 S + targets) */
typedef struct ex_target {
   const char *name;
   size_t count;
   const uint32_t *at;            /* (count) ascending, below V */
   const float *offset;           /* (count,3) */
   float rest;                    /* its weight where nothing is animated */
} ex_target;
typedef struct ex_rig {
   const char *name;
   size_t vertices, triangles, influences, joints, targets, frames; /* V T I S M F */
   const float *positions, *normals, *uv; /* (V,3) (V,3) unit, (V,2) or NULL */
   const uint32_t *triangle;      /* (T,3) */
   const uint32_t *skin_joints;   /* (V,I) below S */
   const float *skin_weights;     /* (V,I) */
   const char *const *names;      /* (S) */
   const int32_t *parents;        /* (S) -1 for a root, else earlier */
   const float *joint_rest;       /* (S,3) */
   const ex_target *target;       /* (M) */
   const char *motion;            /* name of the animation */
   const float *times;            /* (F) seconds, ascending, from 0 */
   const float *turns;            /* (F,S,4) local rotations x y z w, unit */
   const float *travel;           /* (F,3) of joint 0: its local translation */
   const float *weights;          /* (F,M) */
} ex_rig;
int ex_write_rig(const char *path, const ex_rig *rig, size_t *bytes /* NULL, or the file's size */, char *error);

#ifdef __cplusplus
}
#endif
#endif
