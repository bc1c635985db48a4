/*  retarget.h - a motion for a skeleton that it was not made for, for the examples
    in        a clip of any skeleton (.glb, .gltf), or axis-angle rotations of this one (.safetensors)
    out       local rotations of a skeleton whose rest rotations are the identity, and the travel of joint 0
    how       a joint turns in the world as the node of its name does, away from that node's rest; where a bone of the two
              rest poses points elsewhere by more than 20 degrees (arms down, arms out), the difference is bridged first.
              Joints without a node keep still on their parent. The travel is scaled by the ratio of hip heights
    errors    as in scene.h */
#ifndef EX_RETARGET_H
#define EX_RETARGET_H
#include "tensors.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct ex_skeleton {
   size_t joints;                /* S */
   const char *const *names;     /* (S) matched after the last ':' or '|', large and small letters alike */
   const int32_t *parents;       /* (S) -1 for joint 0 alone, else earlier */
   const float *rest;            /* (S,3) positions */
} ex_skeleton;
typedef struct ex_turns {
   char *name;
   size_t frames, matched;       /* F; joints that the motion moves */
   size_t bridged;               /* bones whose rest directions differ */
   float *times;                 /* (F) seconds from 0 */
   float *rotations;             /* (F,S,9) local, row-major */
   float *travel;                /* (F,3) of joint 0 from its rest position */
} ex_turns;
/*  path   .glb, .gltf: `which` names an animation as in ex_motion_load. .safetensors: axis_angle [F,S,3] in radians, and
           optional: translation [F,3], metadata fps (30 when not given) */
ex_turns *ex_turns_load(const char *path, const char *which, const ex_skeleton *skeleton, char *error);
void ex_turns_free(ex_turns *turns); /* NULL is allowed */
/*  the rotation matrix (9) as a unit quaternion x y z w */
void ex_quaternion(const float *rotation, float *q);

#ifdef __cplusplus
}
#endif
#endif
