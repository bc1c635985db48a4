/*  mesh.h - a bare triangle mesh from a file, for the examples: no skin, no skeleton
    in        .obj (read here) and .glb / .gltf (tinygltf, in scene_gltf.cc)
    out       render vertices: one for each combination of position, texture coordinate and normal that a face uses
    left out  materials, textures, curves, lines, points; faces of more than three corners become fans
    space     OBJ: as it is. glTF: the scene's, every node's transform applied; a skinned mesh as its file stores it
    errors    as in scene.h: NULL and one line, "file: what is wrong", in error[EX_ERROR] */
#ifndef EX_MESH_H
#define EX_MESH_H
#include "tensors.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct ex_mesh {
   size_t vertices, triangles;   /* V, T: at least 1 */
   float *positions;             /* (V,3) finite */
   float *normals;               /* (V,3) unit, or NULL: the file has none, or not everywhere */
   float *uv;                    /* (V,2) origin at the top left as in glTF, or NULL */
   uint32_t *triangle;           /* (T,3) below V */
   size_t skinned;               /* meshes of the file whose skin is ignored */
} ex_mesh;
ex_mesh *ex_mesh_load(const char *path, char *error);
void ex_mesh_free(ex_mesh *mesh); /* NULL is allowed */

ex_mesh *ex__gltf_mesh(const char *path, char *error); /* between mesh.c and scene_gltf.cc: not yet checked */

#ifdef __cplusplus
}
#endif
#endif
