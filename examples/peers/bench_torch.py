#!/usr/bin/env python3
"""bench_torch.py - times PyTorch on one case, one run for each line on standard input; as bench_deformnet.c

usage     python3 bench_torch.py MODEL CASE.network THREADS [--write FILE]
form      that of export_onnx.py (padded one-rings, all projections of a block in one product, batch norm folded away), traced
          and frozen by TorchScript: the fastest that we found
--write   runs once and leaves the displacement as raw float32
BLAS      PyTorch from Debian takes the system's; with libopenblas0-pthread two threads are slower than one: see the Makefile
"""
import sys
import time
import warnings

import torch

import export_onnx


def main():
    model, case, threads = sys.argv[1:4]
    torch.set_num_threads(int(threads))
    torch.set_num_interop_threads(1)
    module, _, rows = export_onnx.load(model, case)
    with torch.no_grad():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            traced = torch.jit.freeze(torch.jit.trace(module, rows, check_trace=False))
        if len(sys.argv) > 4:
            traced(*rows).numpy().tofile(sys.argv[5])
            return
        for _ in range(2):  # TorchScript rewrites itself on the first runs
            traced(*rows)
        print(f"ready {torch.__version__}", flush=True)
        for line in sys.stdin:
            if line == "prepare\n":
                print("prepared", flush=True)
            elif line == "run\n":
                start = time.perf_counter()
                traced(*rows)
                print(f"{1e3 * (time.perf_counter() - start):.4f}", flush=True)
            else:
                raise SystemExit("expected a line prepare or run")


if __name__ == "__main__":
    main()
