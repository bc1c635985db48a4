"""safetensors_io.py - read and write .safetensors files with numpy alone

shows     the whole format: 8 bytes header length, a JSON header, the tensors one after another
use       tensors, meta = load("model.safetensors")           arrays are views of the mapped file
          save("model.safetensors", tensors, meta)            atomic: a reader never sees half a file
types     F32, F16, F64, I32, I64, U8 as they are; BF16 is widened to float32
"""
import json
import os

import numpy as np

TYPES = {"F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "U8": "|u1"}
NAMES = {np.dtype(t): n for n, t in TYPES.items()}


def header(path):
    """the JSON header and the position of the first tensor byte"""
    with open(path, "rb") as f:
        size = int.from_bytes(f.read(8), "little")
        if size > os.path.getsize(path) - 8:
            raise ValueError(f"{path}: not a whole safetensors file")
        return json.loads(f.read(size)), 8 + size


def load(path):
    """tensors (read-only views of the mapped file) and metadata"""
    head, start = header(path)
    meta = head.pop("__metadata__", {})
    raw = np.memmap(path, np.uint8, "r")
    tensors = {}
    for name, t in head.items():
        first, last = t["data_offsets"]
        piece = raw[start + first:start + last]
        if len(piece) != last - first:
            raise ValueError(f"{path}: {name} runs past the end of the file")
        if t["dtype"] == "BF16":
            values = (piece.view("<u2").astype(np.uint32) << 16).view(np.float32)
        elif (start + first) % np.dtype(TYPES[t["dtype"]]).itemsize:
            values = np.frombuffer(piece.tobytes(), TYPES[t["dtype"]])  # numpy wants aligned views
        else:
            values = piece.view(TYPES[t["dtype"]])
        tensors[name] = values.reshape(t["shape"])
    return tensors, meta


def save(path, tensors, meta=None):
    """write arrays by name and a dictionary of strings"""
    head, at, parts = {"__metadata__": {k: str(v) for k, v in (meta or {}).items()}}, 0, []
    for name, value in tensors.items():
        value = np.asarray(value)
        value = np.ascontiguousarray(value).reshape(value.shape)
        if value.dtype not in NAMES:
            raise TypeError(f"{name}: {value.dtype} has no place in a safetensors file")
        head[name] = {"dtype": NAMES[value.dtype], "shape": list(value.shape), "data_offsets": [at, at + value.nbytes]}
        at += value.nbytes
        parts.append(value)
    text = json.dumps(head, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # keeps the first tensor aligned
    part = f"{path}.part{os.getpid()}"
    with open(part, "wb") as f:
        f.write(len(text).to_bytes(8, "little") + text)
        for value in parts:
            f.write(value.tobytes())
    os.replace(part, path)
