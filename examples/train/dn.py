"""dn.py - deformnet.h from Python, through libdeformnet.so (make libdeformnet.so)

shows     how a character is read, bound and turned into training batches; nothing here repeats what the header computes
use       c = Character("f_tall.glb", joints=names)            weld, graph and geodesic distances, by deformnet.h
          batch = make_batch([Pose(c, palette, truth)], n=None) the whole mesh, or patches of n nodes around seeds
          run = Deformer("model.safetensors", c)               the product itself: dn_rig_create + dn_deform
"""
import ctypes
import hashlib
import json
import os

import numpy as np

import safetensors_io as st

HERE = os.path.dirname(os.path.abspath(__file__))
C = ctypes.CDLL(os.path.join(HERE, "libdeformnet.so"))
FEATURES = ["position", "relative", "normal", "geodesic", "distance"]  # dn_feature, in its order
size_t, vp, u32 = ctypes.c_size_t, ctypes.c_void_p, np.uint32
for name in ("dn_weld_scratch", "dn_weld", "dn_graph_scratch", "dnt_batch", "dnt_struct_size"):
    getattr(C, name).restype = size_t
C.dn_result_text.restype = ctypes.c_char_p


def text(code):
    """what a dn_result means"""
    return C.dn_result_text(ctypes.c_int(code)).decode()


def ptr(a):
    """address of a contiguous array; None is NULL"""
    if a is None:
        return None
    assert a.flags.c_contiguous
    return vp(a.ctypes.data)


# ------------------------------------------------------------------------------------------------ GLB files
class Glb:
    """one skinned mesh and its skeleton, or an animation; only what the training data needs"""

    def __init__(self, path):
        raw = open(path, "rb").read()
        if raw[:4] != b"glTF":
            raise ValueError(f"{path}: not a GLB file")
        n = int.from_bytes(raw[12:16], "little")
        self.path, self.json, self.bin = path, json.loads(raw[20:20 + n]), raw[28 + n:]

    def joints(self):
        node = next(n for n in self.json["nodes"] if "mesh" in n and "skin" in n)
        return [short(self.json["nodes"][n]["name"]) for n in self.json["skins"][node["skin"]]["joints"]]

    def accessor(self, index):
        a = self.json["accessors"][index]
        view = self.json["bufferViews"][a["bufferView"]]
        kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[a["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[a["type"]]
        item = np.dtype(kind).itemsize * width
        start, stride = view.get("byteOffset", 0) + a.get("byteOffset", 0), view.get("byteStride", item)
        rows = np.ndarray((a["count"], width), kind, self.bin, start, (stride, np.dtype(kind).itemsize))
        if a.get("normalized"):
            rows = rows.astype(np.float32) / np.iinfo(rows.dtype).max
        return np.ascontiguousarray(rows)


def short(name):
    """joint names without an exporter's prefix, as the header matches them"""
    return name.split(":")[-1].split("|")[-1]


class Pose:
    """a character in one pose: palette (S,12), truth (V,3) or None"""

    def __init__(self, character, palette, truth=None, seed=-1, mirror=0, random=1):
        self.character, self.palette, self.truth = character, palette, truth
        self.seed, self.mirror, self.random = seed, mirror, random


class CharacterStruct(ctypes.Structure):
    _fields_ = [(k, size_t) for k in ("nodes", "influences", "joints", "model_joints", "width")] + [
        (k, vp) for k in ("rest", "joint", "weight", "first_vertex", "triangle", "corner_first", "corner_tri", "first",
                          "next", "geodesic", "joint_rest", "joint_map", "mirror", "partner")]


class PatchStruct(ctypes.Structure):
    _fields_ = [("character", vp), ("palette", vp), ("truth", vp), ("seed", ctypes.c_int64), ("random", ctypes.c_uint64),
                ("mirror", ctypes.c_int32), ("unused", ctypes.c_int32)]


assert C.dnt_struct_size(0) == ctypes.sizeof(CharacterStruct) and C.dnt_struct_size(1) == ctypes.sizeof(PatchStruct)


def mirrored(names, rest):
    """for each joint the one on the other side (Left <-> Right), or None when the names have no sides. Rests on left and
    right being x and -x, as in glTF; a skeleton that faces elsewhere is not mirrored"""
    index = {n: k for k, n in enumerate(names)}
    swap = lambda n: n.replace("Left", "\0").replace("Right", "Left").replace("\0", "Right")
    other = np.array([index.get(swap(n), -1) for n in names])
    if (other < 0).any() or (other == np.arange(len(names))).all():
        return None
    flipped = rest[other] * [-1, 1, 1]
    return other.astype(u32) if np.abs(flipped - rest).max() < 0.05 * np.ptp(rest, axis=0).max() else None


class Character:
    """a rest mesh bound as the header binds it. joints: the model's joint names, default all of the character's"""

    def __init__(self, path, joints=None, resolution=128, cache=None):
        g = Glb(path)
        self.path, self.name = path, os.path.splitext(os.path.basename(path))[0]
        node = next(n for n in g.json["nodes"] if "mesh" in n and "skin" in n)
        part, skin = g.json["meshes"][node["mesh"]]["primitives"][0], g.json["skins"][node["skin"]]
        at = part["attributes"]
        self.positions = g.accessor(at["POSITION"]).astype(np.float32)
        self.indices = np.ascontiguousarray(g.accessor(part["indices"]).reshape(-1, 3).astype(u32))
        sets = [k for k in range(8) if f"JOINTS_{k}" in at]
        self.skin_joint = np.hstack([g.accessor(at[f"JOINTS_{k}"]) for k in sets]).astype(u32)
        self.skin_weight = np.hstack([g.accessor(at[f"WEIGHTS_{k}"]) for k in sets]).astype(np.float32)
        nodes, self.joint_names = skin["joints"], g.joints()
        child = {c: n for n in nodes for c in g.json["nodes"][n].get("children", [])}
        self.parents = np.array([nodes.index(child[n]) if n in child else -1 for n in nodes], np.int32)
        self.inverse_bind = g.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)  # row-major
        self.joint_positions = np.linalg.inv(self.inverse_bind.astype(float))[:, :3, 3].astype(np.float32)
        self.bind(joints or self.joint_names, resolution, cache)

    def bind(self, joints, resolution, cache):
        missing = [j for j in joints if j not in self.joint_names]
        if missing:
            raise ValueError(f"{self.path}: no joint {', '.join(missing)}")
        V, T, I = len(self.positions), len(self.indices), self.skin_joint.shape[1]
        self.node_of_vertex, first_vertex = np.empty(V, u32), np.empty(V, u32)
        scratch = np.empty(C.dn_weld_scratch(size_t(V)) + 64, np.uint8)
        N = C.dn_weld(ptr(self.positions), size_t(V), ptr(self.skin_joint), ptr(self.skin_weight), size_t(I), ctypes.c_float(0),
                      ptr(self.node_of_vertex), ptr(first_vertex), None, ptr(scratch))
        self.nodes, self.first_vertex = N, first_vertex[:N].copy()
        self.rest = np.ascontiguousarray(self.positions[self.first_vertex])
        self.joint, self.weight = (np.ascontiguousarray(a[self.first_vertex]) for a in (self.skin_joint, self.skin_weight))
        t = self.node_of_vertex[self.indices]
        self.triangle = np.ascontiguousarray(t[(t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])])
        self.first, nxt = np.empty(N + 1, u32), np.empty(6 * T, u32)
        scratch = np.empty(C.dn_graph_scratch(size_t(N), size_t(T)) + 64, np.uint8)
        graph = (size_t * 3)()
        all_t = np.ascontiguousarray(t)
        C.dn_graph_build(ptr(all_t), size_t(T), size_t(N), ptr(self.first), ptr(nxt), graph, ptr(scratch))
        self.next = nxt[:self.first[-1]].copy()
        self.corner_first, self.corner_tri = np.empty(N + 1, u32), np.empty(3 * len(self.triangle), u32)
        C.dnt_corners(ptr(self.triangle), size_t(len(self.triangle)), size_t(N), ptr(self.corner_first), ptr(self.corner_tri))
        self.model_joints = list(joints)
        self.joint_map = np.array([self.joint_names.index(j) for j in joints], u32)
        self.joint_rest = np.ascontiguousarray(self.joint_positions[self.joint_map])
        self.mirror = mirrored(self.model_joints, self.joint_rest)
        self.all_geodesic = self.distances(resolution, cache)
        self.geodesic = np.ascontiguousarray(self.all_geodesic[:, self.joint_map])
        self.partner = np.arange(N, dtype=np.int32)
        self.degree = int(np.diff(self.first).max()) + 1
        self.struct = CharacterStruct(N, I, len(self.joint_names), len(joints), self.degree, *[
            None if a is None else a.ctypes.data for a in (
                self.rest, self.joint, self.weight, self.first_vertex, self.triangle, self.corner_first, self.corner_tri,
                self.first, self.next, self.geodesic, self.joint_rest, self.joint_map, self.mirror, self.partner)])

    def distances(self, resolution, cache):
        """volumetric geodesic distance (N, all joints) by the header. Kept in the cache folder under a hash of what it depends
        on, the header's method included: a coarse solve with few joints stands for that"""
        def solve(joints, cells):
            out = np.empty((self.nodes, len(joints)), np.float32)
            code = C.dnt_geodesic(ptr(self.rest), size_t(self.nodes), ptr(self.triangle), size_t(len(self.triangle)), ptr(joints),
                                  size_t(len(joints)), ctypes.c_uint(cells), ptr(out))
            if code:
                raise RuntimeError(f"{self.path}: geodesic distances: {text(code)}")
            return out

        parts = (self.rest, self.triangle, self.joint_positions, np.array(resolution), solve(self.joint_positions[:3].copy(), 24))
        key = hashlib.sha256(b"".join(a.tobytes() for a in parts)).hexdigest()[:16]
        kept = os.path.join(cache, f"{self.name}-{key}.safetensors") if cache else None
        if kept and os.path.exists(kept):
            return np.array(st.load(kept)[0]["geodesic"])
        out = solve(self.joint_positions, resolution)
        if kept:
            os.makedirs(cache, exist_ok=True)
            st.save(kept, {"geodesic": out})
        return out

    def contract(self, ds):
        """pair nodes by the scores whose halves are ds (N,2): batches restrict the pairs to their patches"""
        ds = np.ascontiguousarray(ds, np.float32)
        if not C.dnt_contract(ctypes.byref(self.struct), ptr(ds), ptr(self.partner)):
            raise MemoryError("dnt_contract")

    def displacement(self, palette, truth):
        """skinned nodes and truth - skinned, (N,3) each, model space"""
        coarse, delta = np.empty((self.nodes, 3), np.float32), np.empty((self.nodes, 3), np.float32)
        C.dnt_displacement(ctypes.byref(self.struct), ptr(palette), ptr(truth), ptr(coarse), ptr(delta))
        return coarse, delta


def row_width(features, joints):
    return sum(joints if f in ("geodesic", "distance") else 3 for f in features)


def make_batch(poses, features, root, n=None, halo=0, scale=None, pool=True, width=None):
    """rows, tables and targets of one patch of n nodes for each pose (n None: one whole mesh) -> dictionary of arrays.
    scale: (2,D) mean and 1/std. With pool the characters' contractions must be set"""
    n = n or poses[0].character.nodes
    P, total = len(poses), n * len(poses)
    small = [p.character.path for p in poses if p.character.nodes < n or p.seed < 0 and p.character.nodes != n]
    if small:
        raise ValueError(f"{small[0]}: has no {n} nodes")
    width = width or max(p.character.degree for p in poses)
    coarse_width, D = 2 * width, row_width(features, len(poses[0].character.model_joints))
    patches = (PatchStruct * P)(*[PatchStruct(
        ctypes.addressof(p.character.struct), p.palette.ctypes.data, None if p.truth is None else p.truth.ctypes.data,
        p.seed, p.random, p.mirror, 0) for p in poses])
    f32, i32, i64 = np.float32, np.int32, np.int64
    b = dict(rows=np.empty((total, D), f32), target=np.empty((total, 3), f32), use=np.empty(total, f32),
             node=np.empty(total, u32), table=np.empty((total, width), i32), degree=np.empty(total, i32))
    p = dict(members=np.empty((total, 2), i64), slot=np.empty(total, i32), cluster=np.empty(total, i64),
             coarse_table=np.empty((total, coarse_width), i32), coarse_degree=np.empty(total, i32),
             coarse_offset=np.empty(P + 1, i64)) if pool else {}
    order = ("members", "slot", "cluster", "coarse_table", "coarse_degree", "coarse_offset")
    kinds = np.array([FEATURES.index(f) for f in features] + [-1], i32)
    m = C.dnt_batch(patches, size_t(P), size_t(n), ptr(kinds), int(root), int(halo), ptr(scale), size_t(D), size_t(width),
                    size_t(coarse_width), *[ptr(a) for a in b.values()], *[ptr(p.get(k)) for k in order])
    if m == 0:
        raise MemoryError("dnt_batch")
    for k in ("members", "slot", "coarse_table", "coarse_degree"):
        if pool:
            p[k] = p[k][:m]
    return dict(b, **p, offset=np.arange(P + 1, dtype=i64) * n)


class Deformer:
    """the product on a character: Deformer(character, "model.safetensors"), or without a model LBS or DQS"""

    def __init__(self, character, model=None, dqs=False):
        c = self.character = character
        names = (ctypes.c_char_p * len(c.joint_names))(*[n.encode() for n in c.joint_names])
        inverse = np.ascontiguousarray(c.inverse_bind[:, :3].astype(np.float32))
        info = ctypes.create_string_buffer(240)
        seen = st.load(model)[1]["deformnet.joints"].split(",") if model else []
        known = np.ascontiguousarray(c.all_geodesic[:, [c.joint_names.index(j) for j in seen]]) \
            if model and set(seen) <= set(c.joint_names) else None
        C.dnt_deformer_new.restype = vp
        self.handle = C.dnt_deformer_new(
            model.encode() if model else None, ptr(c.positions), size_t(len(c.positions)), ptr(c.indices), size_t(len(c.indices)),
            ptr(c.skin_joint), ptr(c.skin_weight), size_t(c.skin_joint.shape[1]), size_t(len(c.joint_names)), names, ptr(c.parents),
            ptr(inverse), ptr(known), size_t(0 if known is None else c.nodes), int(dqs), info)
        if not self.handle:
            raise RuntimeError(f"{c.path}: {info.value.decode()}")

    def __call__(self, palette):
        """palette (S,3,4) -> vertices (V,3)"""
        out, palette = np.empty_like(self.character.positions), np.ascontiguousarray(palette, np.float32)
        code = C.dnt_deform(vp(self.handle), ptr(palette), ptr(out))
        if code and text(code) != "some nodes were not finite and stayed plainly skinned":
            raise RuntimeError(text(code))
        return out

    def rows(self, palette, width):
        out, palette = np.empty((self.character.nodes, width), np.float32), np.ascontiguousarray(palette, np.float32)
        code = C.dnt_rig_rows(vp(self.handle), ptr(palette), ptr(out))
        if code:
            raise RuntimeError(text(code))
        return out

    def __del__(self):
        if getattr(self, "handle", None):
            C.dnt_deformer_free(vp(self.handle))
