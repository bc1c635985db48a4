#!/usr/bin/env python3
"""convert_nbs.py - the published checkpoint of Neural Blend Shapes as one model file for deformnet.h

in      a folder of PyTorch state dictionaries, as github.com/PeizhuoLi/neural-blend-shapes writes and publishes them:
           att, geo, geo2, dec   N.conv.weight (out,in,1,5), N.conv.bias          MeshCNN convolutions
           gen                   N.0.weight (S*out,S*in), N.0.bias, N.0.mask      skeleton-aware layers, times their mask
           coff                  coff_branch.J.layers.N.0.weight, .bias           an MLP for joint J + 1
        each in FOLDER/NAME/model/latest.pt; FOLDER/args.txt, when there, must not say another network than this one
out     one .safetensors with the same numbers under deformnet's names: att.N, geo.N, gen.N, geo2.N, dec.N, coff.J.N.
        Nothing is transposed; in gen the blocks that the mask hides are written as zeros
run     python3 convert_nbs.py pre_trained nbs.safetensors --f16
safety  nothing but tensors is unpickled; no code of the files runs
"""
import argparse
import collections
import inspect
import io
import os
import pickle
import re
import shlex
import sys
import zipfile

import numpy as np

import safetensors_io as st

try:
    import torch
except ImportError:  # not needed for files written by PyTorch 1.6 or newer
    torch = None

BRANCHES = {"att": 4, "geo": 4, "gen": 4, "geo2": 4, "dec": 2, "coff": 3}  # layers in each
SMPL = "-1,0,0,0,1,2,3,4,5,6,7,8,9,9,9,12,13,14,16,17,18,19,20,21"  # the skeleton of the published weights
NAMES = {
    "smpl": "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot "
            "right_foot neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow "
            "left_wrist right_wrist left_hand right_hand",
    "mixamo": "Hips LeftUpLeg RightUpLeg Spine LeftLeg RightLeg Spine1 LeftFoot RightFoot Spine2 LeftToeBase "
              "RightToeBase Neck LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm "
              "LeftHand RightHand LeftHandMiddle1 RightHandMiddle1",
}
LICENCE = ("BSD-2-Clause, Copyright (c) 2021 Peizhuo Li (the repository's licence; the weights were trained on data of "
           "SMPL bodies, whose own terms may bind you)")


class Bad(Exception):
    """what is wrong with the input, in one line"""


# ------------------------------------------------------------------------------------------------ reading
def restricted(path):
    """the same without PyTorch: a zip of data.pkl and one file for each storage, unpickled by a reader that knows
    dictionaries and tensors and refuses every other name"""
    kinds = {"Float": "<f4", "Double": "<f8", "Half": "<f2", "Long": "<i8", "Int": "<i4", "Short": "<i2", "Char": "i1", "Byte": "u1", "Bool": "u1"}

    def tensor(storage, offset, size, stride, *_):
        last = offset + sum((n - 1) * step for n, step in zip(size, stride))
        if min(size, default=1) <= 0 or min(stride, default=0) < 0 or offset < 0 or len(size) != len(stride) or last >= len(storage):
            raise pickle.UnpicklingError("a tensor that leaves its storage")
        return np.lib.stride_tricks.as_strided(storage[offset:], size, [step * storage.itemsize for step in stride])

    class Unpickler(pickle.Unpickler):
        def find_class(self, module, name):
            if (module, name) == ("collections", "OrderedDict"):
                return collections.OrderedDict
            if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
                return tensor
            if (module, name) == ("torch._utils", "_rebuild_parameter"):
                return lambda value, *_: value
            if module == "torch" and name.endswith("Storage") and name[:-7] in kinds:
                return kinds[name[:-7]]
            raise pickle.UnpicklingError(f"wants {module}.{name}")

        def persistent_load(self, pid):
            kind, dtype, key, _, count = pid
            record = records.getinfo(f"{root}data/{key}")
            if kind != "storage" or record.compress_type != zipfile.ZIP_STORED or record.file_size != count * np.dtype(dtype).itemsize:
                raise pickle.UnpicklingError(f"storage {key} does not hold {count} numbers")
            return np.frombuffer(records.read(record), dtype)

    if not zipfile.is_zipfile(path):
        raise ValueError("neither empty nor whole, or older than PyTorch 1.6, which only PyTorch 1.13 or newer can read safely")
    with zipfile.ZipFile(path) as records:
        root = [n[:-8] for n in records.namelist() if n.endswith("data.pkl")][0]
        return Unpickler(io.BytesIO(records.read(root + "data.pkl"))).load()


def safe(path):
    """torch.load where it can be told to read tensors only, the reader above elsewhere. (pickle_module is no way to
    have both: there are builds of PyTorch that ignore it.)"""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as records:
            if any(n.endswith("constants.pkl") for n in records.namelist()):
                raise ValueError("a TorchScript program")  # torch.load would run it
    if torch is None or "weights_only" not in inspect.signature(torch.load).parameters:
        return restricted(path)
    state = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(state, dict):
        return state
    return {k: v.detach().float().numpy() if isinstance(v, torch.Tensor) and v.dtype == torch.bfloat16 else v.detach().numpy() if isinstance(v, torch.Tensor) else v
            for k, v in state.items()}


def read(folder, branch, reader=safe):
    """the tensors of one branch, by the authors' names"""
    path = os.path.join(folder, branch, "model", "latest.pt")
    if not os.path.isfile(path):
        raise Bad(f"{path}: no such file; expected {', '.join(BRANCHES)} in {folder}, each with model/latest.pt")
    try:
        state = reader(path)
    except OSError:
        raise
    except Exception as e:  # whatever a spoilt file leads to
        raise Bad(f"{path}: not a file of tensors: {(str(e) or type(e).__name__).splitlines()[0]}")
    if not isinstance(state, dict) or not state:
        raise Bad(f"{path}: expected a state dictionary, found {type(state).__name__}")
    for key, value in state.items():
        if not isinstance(key, str) or not isinstance(value, np.ndarray):
            raise Bad(f"{path}: {key!r}: expected a tensor, found {type(value).__name__}")
        if value.dtype.kind != "f":
            raise Bad(f"{path}: {key}: expected floating point numbers, found {value.dtype}")
    return path, dict(state)


class Branch:
    """one file: every key is asked for once, with the shape it must have; what is left over is an error"""

    def __init__(self, folder, name, reader):
        self.path, self.state = read(folder, name, reader)

    def take(self, key, *shape):
        """the tensor; None in shape: any length"""
        if key not in self.state:
            raise Bad(f"{self.path}: {key} is missing; the file has {', '.join(sorted(self.state)[:8])}{', ...' * (len(self.state) > 8)}")
        value = self.state.pop(key)
        wanted = "(" + ",".join("any" if n is None else str(n) for n in shape) + ")"
        if value.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, value.shape)) or 0 in value.shape:
            raise Bad(f"{self.path}: {key}: expected {wanted}, found ({','.join(map(str, value.shape))})")
        value = np.ascontiguousarray(value, np.float32)
        if not np.isfinite(value).all():
            raise Bad(f"{self.path}: {key}: has numbers that are not finite")
        return value

    def done(self, ignored=()):
        left = [k for k in sorted(self.state) if k not in ignored]
        if left:
            raise Bad(f"{self.path}: unexpected {', '.join(left[:6])}{', ...' * (len(left) > 6)}")


# ------------------------------------------------------------------------------------------------ the network
def reach(parents):
    """(S,S) steps between joints in the skeleton tree"""
    s = len(parents)
    steps = np.full((s, s), 10 * s)
    for j in range(s):
        steps[j, j] = 0
        if parents[j] >= 0:
            k = parents[j]
            steps[j, :j] = steps[k, :j] + 1
            steps[:j, j] = steps[j, :j]
    return steps


def convert(folder, parents, reader=safe):
    """deformnet's tensors by name"""
    s, out = len(parents), {}

    def mesh(name, first):
        b, width = Branch(folder, name, reader), first
        for n in range(BRANCHES[name]):
            w = b.take(f"{n}.conv.weight", None, width, 1, 5)
            out[f"{name}.{n}.weight"] = w
            out[f"{name}.{n}.bias"] = b.take(f"{n}.conv.bias", len(w))
            width = len(w)
        b.done()
        return b.path, width

    path, width = mesh("att", 3)
    if width != s:
        raise Bad(f"{path}: expected weights for the {s} joints of --parents, found {width}")
    _, wide = mesh("geo", 3)
    b, near = Branch(folder, "gen", reader), reach(parents) <= 2
    for n in range(BRANCHES["gen"]):
        w = b.take(f"{n}.0.weight", None, s * wide)
        mask = b.take(f"{n}.0.mask", *w.shape)
        if len(w) % s:
            raise Bad(f"{b.path}: {n}.0.weight: expected rows in {s} equal groups, one for each joint, found {len(w)}")
        if not np.isin(mask, (0, 1)).all():
            raise Bad(f"{b.path}: {n}.0.mask: expected zeros and ones")
        blocks = mask.reshape(s, len(w) // s, s, wide)
        if (blocks.min((1, 3)) != blocks.max((1, 3))).any() or ((blocks[:, 0, :, 0] > 0) != near).any():
            raise Bad(f"{b.path}: {n}.0.mask: expected ones for joints at most 2 steps apart in the tree {','.join(map(str, parents))}, "
                      "and zeros elsewhere; another skeleton needs --parents")
        out[f"gen.{n}.weight"] = w * mask
        out[f"gen.{n}.bias"] = b.take(f"{n}.0.bias", len(w))
        wide = len(w) // s
    if wide != 3:
        raise Bad(f"{b.path}: expected three coordinates for each joint, found {wide}")
    b.done()
    _, wide = mesh("geo2", 3)
    path, width = mesh("dec", wide + s)
    if width % 3:
        raise Bad(f"{path}: expected blend shapes of three coordinates, found {width} channels")
    b = Branch(folder, "coff", reader)
    for j in range(s - 1):
        wide = 9
        for n in range(BRANCHES["coff"]):
            w = b.take(f"coff_branch.{j}.layers.{n}.0.weight", width // 3 if n == BRANCHES["coff"] - 1 else None, wide)
            out[f"coff.{j}.{n}.weight"] = w
            out[f"coff.{j}.{n}.bias"] = b.take(f"coff_branch.{j}.layers.{n}.0.bias", len(w))
            wide = len(w)
    b.done(("basis", "mask"))  # of the mesh that it was trained on
    return out


def check_arguments(folder):
    """the options that the network was built with; those that no tensor shows must be the paper's"""
    path = os.path.join(folder, "args.txt")
    if not os.path.isfile(path):
        return False
    with open(path, encoding="utf-8", errors="replace") as f:
        words = shlex.split(f.readline())
    for key, paper in (("pool_ratio", 0.2), ("pool_method", "max"), ("skeleton_aware", 1)):
        found = [m.group(1) for m in (re.match(rf"--{key}=(.*)", w) for w in words) if m]
        found += [words[i + 1] for i in range(len(words) - 1) if words[i] == f"--{key}"]
        try:
            same = not found or type(paper)(found[-1]) == paper
        except ValueError:
            same = False
        if not same:
            raise Bad(f"{path}: --{key} {found[-1]}: expected {paper}, all that deformnet computes")
    return True


def main():
    p = argparse.ArgumentParser(description="Neural Blend Shapes' checkpoint folder -> one .safetensors for deformnet.h")
    p.add_argument("folder", help="holds att, geo, gen, geo2, dec, coff, each with model/latest.pt (the authors' pre_trained)")
    p.add_argument("out")
    p.add_argument("--f16", action="store_true", help="half precision: 200 MB instead of 400 MB at full size")
    p.add_argument("--parents", default=SMPL, help="parent of each joint, -1 for the root; SMPL's 24 joints if not given")
    p.add_argument("--joints", default="smpl", help="names by which motions match: smpl, mixamo, or a list with commas")
    p.add_argument("--licence", default=LICENCE, help="text for deformnet.licence")
    p.add_argument("--trained-on", default="the published Neural Blend Shapes training (SMPL bodies, garments)", help="text for deformnet.trained_on")
    o = p.parse_args()
    try:
        try:
            parents = [int(x) for x in o.parents.split(",")]
        except ValueError:
            raise Bad(f"--parents {o.parents}: expected whole numbers with commas")
        if parents[:1] != [-1] or any(not 0 <= q < j for j, q in enumerate(parents) if j):
            raise Bad(f"--parents {o.parents}: expected -1 first, then for each joint an earlier one")
        names = NAMES[o.joints].split() if o.joints in NAMES else o.joints.split(",")
        if len(names) != len(parents) or "" in names or len(set(names)) != len(names):
            raise Bad(f"--joints: expected {len(parents)} different names, found {len(names)}")
        if not os.path.isdir(o.folder):
            raise Bad(f"{o.folder}: no such folder")
        told = check_arguments(o.folder)
        tensors = convert(o.folder, parents)
        biggest = max(float(np.abs(t).max()) for t in tensors.values())
        lost = 0.0
        if o.f16:
            if biggest > 65504:
                raise Bad(f"a number of magnitude {biggest:.3g} does not fit F16")
            for name in tensors:
                half = tensors[name].astype(np.float16)
                lost = max(lost, float(np.abs(half.astype(np.float32) - tensors[name]).max()) / (float(np.abs(tensors[name]).max()) or 1))
                tensors[name] = half
        st.save(o.out, tensors, {
            "deformnet.version": "1", "deformnet.arch": "neuralblendshapes", "deformnet.frame": "model", "deformnet.unit": "1",
            "deformnet.parents": ",".join(map(str, parents)), "deformnet.joints": ",".join(names),
            "deformnet.licence": o.licence, "deformnet.trained_on": o.trained_on})
    except (Bad, OSError) as e:
        print(f"convert_nbs: {e}", file=sys.stderr)
        return 1
    print(f"{o.out}: {len(tensors)} tensors, {sum(t.size for t in tensors.values()):,} numbers, {os.path.getsize(o.out) / 1e6:.1f} MB"
          + (f", F16 (largest rounding {lost:.1e} of its tensor's largest number)" if o.f16 else "")
          + ("" if told else "; no args.txt: taken as the paper's pooling"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
