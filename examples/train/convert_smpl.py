#!/usr/bin/env python3
"""convert_smpl.py - an SMPL-family body that you are licensed to use as a body file for deformnet.h (dn_shape)

in      .pkl as distributed for SMPL (Python 2 pickles with chumpy and scipy.sparse objects, or cleaned ones), or .npz as
        for SMPL-H, SMPL-X and the like. Read are v_template (V,3), f (T,3), shapedirs (V,3,B), posedirs (V,3,9(S-1)),
        weights (V,S), J_regressor (S,V), kintree_table (2,S)
out     .safetensors: template, faces, shapedirs, posedirs, weights, joint_regressor, parents; joint_names where the number
        of joints is that of SMPL (24), SMPL-H (52) or SMPL-X (55)
run     python3 convert_smpl.py basicModel_f_lbs_10_207_0_v1.0.0.pkl body.safetensors
        python3 convert_smpl.py SMPLX_NEUTRAL.npz body.safetensors --betas 16 --f16
safety  a pickle can name any function to be called. Here only the layout of numpy arrays, sparse matrices and chumpy
        arrays is known, by stand-ins of our own that keep what they are given; numpy, scipy and chumpy are never handed
        anything but raw bytes, and every other name is refused before anything of it is looked up
licence the result is under the body model's own terms; it may not be passed on where those forbid it
"""
import argparse
import ast
import io
import json
import os
import pickle
import sys
import zipfile

import numpy as np

import safetensors_io as st

BODY = ("pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot neck "
        "left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist").split()
FINGERS = [f"{side}_{finger}{k}" for side in ("left", "right") for finger in ("index", "middle", "pinky", "ring", "thumb") for k in (1, 2, 3)]
NAMES = {24: BODY + ["left_hand", "right_hand"], 52: BODY + FINGERS, 55: BODY + ["jaw", "left_eye_smplhf", "right_eye_smplhf"] + FINGERS}
NUMBERS = {kind + str(size) for kind in "iu" for size in (1, 2, 4, 8)} | {"f2", "f4", "f8", "b1"}


class Bad(Exception):
    """what is wrong with the input, in one line"""


# ------------------------------------------------------------------------------------------------ stand-ins
class Stub:
    """an object of a known class: keeps its arguments and its state, does nothing"""

    def __new__(cls, *args, **_):
        self = object.__new__(cls)
        self.args, self.state = args, None
        return self

    def __init__(self, *_, **__):
        pass

    def __setstate__(self, state):
        self.state = state


class Dtype(Stub):
    """numpy.dtype: a simple number, or None for anything else"""

    def plain(self):
        code = str(self.args[0]) if self.args else ""
        order = str(self.state[1]) if isinstance(self.state, tuple) and len(self.state) > 1 else "<"
        code = code.lstrip("<>|=")
        if code not in NUMBERS or order not in ("<", ">", "|", "="):
            return None
        return np.dtype(("<" if order in "|=" else order) + code)


class Array(Stub):
    """numpy.ndarray: state is (version, shape, dtype, is_fortran, bytes)"""

    def value(self):
        if not isinstance(self.state, tuple) or len(self.state) != 5 or not isinstance(self.state[2], Dtype):
            raise Bad("an array without its state")
        _, shape, dtype, fortran, data = self.state
        dtype = dtype.plain()
        if isinstance(data, str):  # a Python 2 string, read as latin-1
            data = data.encode("latin-1")
        if dtype is None or not isinstance(data, bytes):
            raise Bad("an array that does not hold numbers")
        if not isinstance(shape, tuple) or not all(isinstance(n, int) and n >= 0 for n in shape):
            raise Bad("an array without a shape")
        count = 1
        for n in shape:
            count *= n
        if count * dtype.itemsize != len(data):
            raise Bad(f"an array of {len(data)} bytes for {count} numbers of {dtype.itemsize}")
        return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


class Scalar(Stub):
    """numpy scalar: (dtype, bytes)"""


class Sparse(Stub):
    """scipy.sparse matrices: state is their __dict__"""
    kind = ""

    def value(self):
        s = self.state if isinstance(self.state, dict) else {}
        s = {str(k).lstrip("_"): v for k, v in s.items()}
        shape = tuple(int(number(n)) for n in s.get("shape", ()))
        if len(shape) != 2 or min(shape) < 1 or shape[0] * shape[1] > 1 << 28:
            raise Bad(f"a sparse matrix of shape {shape}")
        dense = np.zeros(shape, np.float64)
        data = array(s.get("data"), "sparse data").astype(np.float64).ravel()
        if self.kind == "coo":
            row, col = (array(s.get(k), "sparse " + k).astype(np.int64).ravel() for k in ("row", "col"))
        else:
            first = array(s.get("indptr"), "sparse indptr").astype(np.int64).ravel()
            other = array(s.get("indices"), "sparse indices").astype(np.int64).ravel()
            major = shape[1] if self.kind == "csc" else shape[0]
            if len(first) != major + 1 or first[0] != 0 or (np.diff(first) < 0).any() or first[-1] != len(data):
                raise Bad("a sparse matrix whose indptr does not fit")
            along = np.repeat(np.arange(major), np.diff(first))
            row, col = (other, along) if self.kind == "csc" else (along, other)
        if not len(row) == len(col) == len(data) or (len(data) and (min(row.min(), col.min()) < 0 or row.max() >= shape[0] or col.max() >= shape[1])):
            raise Bad("a sparse matrix with an entry outside it")
        np.add.at(dense, (row, col), data)
        return dense


class Chumpy(Stub):
    """chumpy.ch.Ch keeps its numbers as x; chumpy.reordering.Select takes some of another's"""
    name = ""

    def value(self):
        s = self.state if isinstance(self.state, dict) else {}
        if "x" in s:
            return array(s["x"], "chumpy array")
        if self.name == "Select" and "a" in s and "idxs" in s:
            source, at = array(s["a"], "chumpy array").ravel(), array(s["idxs"], "chumpy indices").astype(np.int64).ravel()
            if len(at) and (at.min() < 0 or at.max() >= len(source)):
                raise Bad("a chumpy selection outside its array")
            shape = s.get("preferred_shape")
            return source[at].reshape([int(number(n)) for n in shape]) if shape is not None else source[at]
        raise Bad(f"a chumpy object of kind {self.name} that holds no numbers of its own")


def number(x):
    """a Python number, or a numpy scalar of the file"""
    if isinstance(x, Scalar) and len(x.args) == 2 and isinstance(x.args[0], Dtype) and x.args[0].plain() is not None:
        raw = x.args[1].encode("latin-1") if isinstance(x.args[1], str) else x.args[1]
        if isinstance(raw, bytes) and len(raw) == x.args[0].plain().itemsize:
            return np.frombuffer(raw, x.args[0].plain())[0]
    if isinstance(x, (int, float)):
        return x
    raise Bad("a number is missing")


def array(x, what):
    if isinstance(x, (Array, Sparse, Chumpy)):
        try:
            return x.value()
        except (ValueError, RecursionError) as e:
            raise Bad(f"{what}: {e}") from None
    if isinstance(x, np.ndarray) and x.dtype.kind in "iufb":
        return x
    raise Bad(f"{what}: expected numbers, found {type(x).__name__}")


def encode(text, how="latin1"):
    """_codecs.encode, by which Python 3 puts bytes into old pickles"""
    if not isinstance(text, str) or str(how) not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError("an encoding other than latin1")
    return text.encode("latin-1")


def rebuild(cls, *_):
    """copy_reg._reconstructor and the like, for stand-ins only"""
    if not (isinstance(cls, type) and issubclass(cls, Stub)):
        raise pickle.UnpicklingError("rebuilds something that is not an array")
    return cls()


def container(kind):
    def make(items=()):
        return kind(items) if isinstance(items, (list, tuple, set)) else kind()
    return make


class Reader(pickle.Unpickler):
    def find_class(self, module, name):
        if module in ("numpy.core.multiarray", "numpy._core.multiarray"):
            if name == "_reconstruct":
                return rebuild
            if name == "scalar":
                return Scalar
        if module == "numpy" and name == "ndarray":
            return Array
        if module == "numpy" and name == "dtype":
            return Dtype
        if module.startswith("scipy.sparse") and name[:3] in ("csc", "csr", "coo") and name[3:] in ("_matrix", "_array"):
            return type("Sparse_" + name[:3], (Sparse,), {"kind": name[:3]})
        if module == "chumpy" or module.startswith("chumpy."):
            return type("Chumpy_" + name, (Chumpy,), {"name": name})
        if (module, name) in (("copy_reg", "_reconstructor"), ("copyreg", "_reconstructor"), ("copy_reg", "__newobj__"), ("copyreg", "__newobj__")):
            return rebuild
        if (module, name) in (("__builtin__", "object"), ("builtins", "object")):
            return Stub
        if (module, name) in (("__builtin__", "set"), ("builtins", "set")):
            return container(set)
        if (module, name) == ("collections", "OrderedDict"):
            return container(dict)
        if (module, name) == ("_codecs", "encode"):
            return encode
        raise pickle.UnpicklingError(f"wants {module}.{name}, which has no place in a body model")

    def persistent_load(self, pid):
        raise pickle.UnpicklingError("wants an object from outside the file")


def unpickle(data, path):
    try:
        return Reader(io.BytesIO(data), encoding="latin1").load()
    except Bad:
        raise
    except Exception as e:  # a broken pickle can fail in any way; none of them runs anything
        raise Bad(f"{path}: refused: {e or type(e).__name__}") from None


# ------------------------------------------------------------------------------------------------ files
def read_npy(data, path):
    """numpy's own file format; an array of objects is a pickle, which goes to the reader above"""
    f = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(f)
        size = int.from_bytes(f.read(2 if version == (1, 0) else 4), "little")
        header = ast.literal_eval(f.read(size).decode("latin-1"))
        shape, fortran, code = header["shape"], header["fortran_order"], str(header["descr"])
    except (ValueError, SyntaxError, KeyError, TypeError, MemoryError, RecursionError) as e:
        raise Bad(f"{path}: not an array: {e}") from None
    if code.lstrip("<>|=") == "O":
        held = unpickle(f.read(), path)
        held = held.state[4] if isinstance(held, Array) and isinstance(held.state, tuple) and len(held.state) == 5 else held
        return held[0] if isinstance(held, list) and len(held) == 1 else held
    stand_in, dtype = Array(), Dtype(code)
    dtype.state = (3, ">" if code.startswith(">") else "<")
    stand_in.state = (1, shape, dtype, bool(fortran), f.read())
    return stand_in


def read(path):
    with open(path, "rb") as f:
        data = f.read()
    if data[:2] != b"PK":
        model = unpickle(data, path)
        if not isinstance(model, dict):
            raise Bad(f"{path}: expected a dictionary, found {type(model).__name__}")
        return {str(k): v for k, v in model.items()}
    wanted = {"v_template", "f", "shapedirs", "posedirs", "weights", "J_regressor", "kintree_table"}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as z:
            found = {}
            for info in z.infolist():
                name = info.filename[:-4] if info.filename.endswith(".npy") else info.filename
                if name in wanted:
                    if info.file_size > 1 << 30:
                        raise Bad(f"{path}: {name} is over a gigabyte")
                    found[name] = read_npy(z.read(info), f"{path}: {name}")
            return found
    except (zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError, zipfile.zlib.error) as e:
        raise Bad(f"{path}: {e}") from None


def take(model, path, name, shape, kinds="iuf"):
    if name not in model:
        raise Bad(f"{path}: {name} is missing; found {', '.join(sorted(model)) or 'nothing'}")
    try:
        x = array(model[name], name)
    except Bad as e:
        raise Bad(f"{path}: {e}") from None
    if x.ndim != len(shape) or any(w and n != w for n, w in zip(x.shape, shape)) or 0 in x.shape:
        raise Bad(f"{path}: {name}: expected ({','.join(str(w or 'any') for w in shape)}), found {x.shape}")
    if x.dtype.kind not in kinds:
        raise Bad(f"{path}: {name}: expected {'integers' if 'f' not in kinds else 'numbers'}, found {x.dtype}")
    if not np.isfinite(x).all():
        raise Bad(f"{path}: {name}: a number is not finite")
    return x


def parents_of(table, path):
    """(2,S): parents, own numbers; the root's parent is -1 or 2^32 - 1"""
    up, own = table.astype(np.int64)
    if sorted(own) != list(range(len(own))):
        raise Bad(f"{path}: kintree_table: the second row must number the joints")
    parents = np.full(len(own), -1, np.int64)
    for joint, above in zip(own, up):
        parents[joint] = -1 if above < 0 or above >= len(own) else above
    if any(p >= s for s, p in enumerate(parents)) or parents[0] != -1:
        raise Bad(f"{path}: kintree_table: a joint comes before its parent")
    return parents.astype(np.int32)


def convert(path, betas):
    m = read(path)
    template = take(m, path, "v_template", (0, 3))
    V = len(template)
    shapedirs = take(m, path, "shapedirs", (V, 3, 0))
    weights = take(m, path, "weights", (V, 0))
    S = weights.shape[1]
    faces = take(m, path, "f", (0, 3), "iu")
    regressor = take(m, path, "J_regressor", (S, V))
    parents = parents_of(take(m, path, "kintree_table", (2, S)), path)
    if faces.astype(np.int64).min() < 0 or faces.astype(np.int64).max() >= V:
        raise Bad(f"{path}: f: an index outside the {V} vertices")
    out = {"template": template, "faces": faces.astype(np.int32), "shapedirs": shapedirs[:, :, :betas], "weights": weights,
           "joint_regressor": regressor, "parents": parents}
    if "posedirs" in m and S > 1:
        out["posedirs"] = take(m, path, "posedirs", (V, 3, 9 * (S - 1)))
    return out


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("model", help=".pkl or .npz")
    p.add_argument("out", help=".safetensors")
    p.add_argument("--betas", type=int, default=10, help="shape coefficients to keep (10)")
    p.add_argument("--f16", action="store_true", help="shapedirs and posedirs in half precision")
    a = p.parse_args()
    if a.betas < 1:
        p.error("--betas: at least 1")
    try:
        out = convert(a.model, a.betas)
    except (Bad, OSError) as e:
        sys.exit(f"convert_smpl.py: {e}")
    for name, x in out.items():
        if x.dtype.kind == "f" or name not in ("faces", "parents"):
            out[name] = x.astype(np.float16 if a.f16 and name.endswith("dirs") else np.float32)
    S = len(out["parents"])
    meta = {"source": os.path.basename(a.model), "licence": "that of the body model it was converted from"}
    if S in NAMES:
        meta["joint_names"] = json.dumps(NAMES[S])
    st.save(a.out, out, meta)
    print(f"{a.out}: {len(out['template'])} vertices, {len(out['faces'])} triangles, {S} joints, {out['shapedirs'].shape[2]} shape coefficients, "
          f"{out['posedirs'].shape[2] if 'posedirs' in out else 0} pose coefficients")


if __name__ == "__main__":
    main()
