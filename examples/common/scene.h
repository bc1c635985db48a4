/*  scene.h - skinned characters and motions from files, for the examples

    in        .glb / .gltf (tinygltf, in scene_gltf.cc) and .safetensors (tensors.h)
    out       one ex_scene (mesh, skin, skeleton) and one ex_motion (a pose per frame), ready for dn_rig_desc:
              positions, triangles, skin_joints, skin_weights, joint names, parents, joint_rest
    space     positions are in the space in which palettes act. For glTF that is mesh-local space: the
              transform of the node that carries a skinned mesh is ignored, as the standard demands
    palettes  (S,12): one row-major 3x4 matrix a joint, world transform times inverse bind, model space
    errors    everything from a file is checked; a function that fails returns NULL or 0 and writes one line,
              "file: what is wrong", to error[EX_ERROR]
    link      tensors.c scene.c scene_gltf.cc; compile scene_gltf.cc with -DEX_TINYGLTF and link -ltinygltf
              where Debian's libtinygltf-dev is installed (without it reading glTF is an error that says so) */
#ifndef EX_SCENE_H
#define EX_SCENE_H
#include "glb.h"
#include "tensors.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct ex_range {         /* one primitive of the file */
   char *name;                    /* its mesh's name */
   size_t first_vertex, vertices, first_triangle, triangles;
} ex_range;

typedef struct ex_scene {
   char *path;                    /* the file it came from */
   size_t vertices, triangles;    /* V, T */
   size_t influences;             /* I: 4 for each JOINTS_n set of the file */
   size_t joints;                 /* S */
   float *positions;              /* (V,3) the file's order; primitives one after another */
   float *normals;                /* (V,3) unit; area-weighted from the triangles where the file has none */
   uint32_t *triangle;            /* (T,3) counter-clockwise from outside */
   uint32_t *skin_joints;         /* (V,I) 0 where the weight is 0 */
   float *skin_weights;           /* (V,I) as in the file, not normalised */
   char **names;                  /* (S) full names, "mixamorig:Hips"; "node7" for an unnamed one */
   int32_t *parents;              /* (S) index, -1 for a root; parents come before children */
   float *rest;                   /* (S,10) local rest: translation 3, rotation x y z w, scale 3 */
   float *above;                  /* (S,12) constant transform between the parent joint (a root: the world) and the
                                     joint's own: nodes that are no joints. Mostly the identity */
   float *inverse_bind;           /* (S,12) row-major 3x4 */
   float *joint_rest;             /* (S,3) joint positions in the space of positions */
   size_t ranges;
   ex_range *range;
   size_t meshes_left_out;        /* meshes of the file that are not skinned, or by another skeleton */
} ex_scene;

ex_scene *ex_scene_load(const char *path, char *error);
void ex_scene_free(ex_scene *scene);   /* NULL is allowed */

/*  ex_scene_save - the character as safetensors, which ex_scene_load reads back

    positions [V,3] F32   triangles [T,3] I32   skin_joints [V,I] I32   skin_weights [V,I] F32
    joint_rest [S,3] F32  parents [S] I32       inverse_bind [S,3,4] F32
    optional: normals [V,3] F32, joint_local [S,10] F32, joint_above [S,3,4] F32 (ex_scene.rest and .above)
    metadata joint_names: comma-separated
    Without inverse_bind it is the translation by -joint_rest; without joint_local the rest rotations are the
    identity and the local translations the differences of joint_rest. */
int ex_scene_save(const ex_scene *scene, const char *path, char *error);

typedef struct ex_motion {
   char *name;                    /* of the animation */
   size_t frames, joints;         /* F; S of the scene it was loaded for */
   float fps;                     /* mean rate, 30 for a single frame */
   float *times;                  /* (F) seconds */
   float *local;                  /* (F,S,10) local transforms like ex_scene.rest; or NULL, and then */
   float *palettes;               /* (F,S,12) given by the file */
   size_t joints_matched;         /* joints of the scene that the motion moves; the others stay at rest */
} ex_motion;

/*  ex_motion_load - a motion, fitted to a character

    path      .glb / .gltf with an animation (may be the character's own file), or .safetensors with
              palettes [F,S,3,4] (and optional metadata fps), for example a truth file
    which     name or number of the animation; NULL or "": the first
    frames    one for each distinct key time of the animation; keys between are LINEAR, STEP or CUBICSPLINE
    matching  by joint name, the part up to the last ':' or '|' ignored. Rotations are copied; a translation
              keeps the character's rest and adds the motion's travel from its own rest, scaled by the ratio of
              hip heights, so that a clip plays on any body of the same skeleton
    error     no joint in common, no such animation (the line lists them), and all that a file can do wrong */
ex_motion *ex_motion_load(const char *path, const char *which, const ex_scene *scene, char *error);
void ex_motion_free(ex_motion *motion);

/*  palettes (S,12) of one frame; frame < F */
void ex_pose(const ex_scene *scene, const ex_motion *motion, size_t frame, float *palette);
/*  the same with the local transforms given: local (S,10); NULL for the rest pose */
void ex_pose_local(const ex_scene *scene, const float *local, float *palette);

/*  linear blend skinning with these palettes, weights normalised; out (V,3). For pictures and comparisons. */
void ex_skin(const ex_scene *scene, const float *palette, float *out);
/*  area-weighted unit normals of positions (V,3); vertices at the same rest place are NOT joined */
void ex_normals(size_t vertices, const float *positions, size_t triangles, const uint32_t *triangle, float *out);
/*  the name without its prefix */
const char *ex_short_name(const char *name);

/* ------------------------------------------------- between scene.c and scene_gltf.cc; not for examples */
typedef struct ex__track { size_t node; int kind; float *values; } ex__track; /* kind 0 t, 1 r, 2 s; (F,3) or (F,4) */
typedef struct ex__clip {         /* an animation with the nodes of its file */
   char *name;
   size_t nodes, frames, tracks;
   char **names;                  /* (nodes) */
   int32_t *parents;              /* (nodes) */
   float *rest;                   /* (nodes,10) */
   float *world;                  /* (nodes,12) at rest */
   float *times;                  /* (frames) */
   ex__track *track;
} ex__clip;
ex_scene *ex__gltf_scene(const char *path, char *error);   /* everything but normals, joint_rest and order */
ex__clip *ex__gltf_clip(const char *path, const char *which, char *error);
void ex__clip_free(ex__clip *clip);
void ex__matrix(const float *trs, double *m);              /* (10) -> row-major 3x4 */
void ex__multiply(const double *a, const double *b, double *out); /* 3x4, out may be a or b */
int ex__invert(const double *m, double *out);              /* 3x4, out may be m; 0: singular, out untouched */

#ifdef __cplusplus
}
#endif
#endif
