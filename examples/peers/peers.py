#!/usr/bin/env python3
"""peers.py - deformnet beside ONNX Runtime and PyTorch: the same weights, mesh and inputs, in turns

run       make -C examples peers        or    python3 peers/peers.py --arch densegats --threads 2 --seconds 60
times     batch 1, float32, rows given, the network only (clothnet: deformnet's time includes its rows, which need the
          coarse garment). Each peer is a process of its own that answers one run at a time;
          a turn is one run to warm the caches and three that count
quiet     a run counts only if the other processes used no more processor time than --noise of the run's, and the peer's
          own threads waited for a processor no longer than that either (/proc/stat, /proc/PID/task/*/schedstat). The
          former is counted in hundredths of a second, so one of those per processor is let pass
prints    median and least of the runs that counted, their number of those made, and the ratio of medians: above 1
          deformnet is faster. Then the processor time of the peer's threads, median of all runs, and its ratio: with one
          thread that tells something on a busy machine too; with more it holds waiting, where waiting spins
fails     when outputs differ by more than 1e-4 of the largest displacement, or when no run of some peer counted
"""
import argparse
import json
import os
import subprocess
import sys
import time

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, "..", "train"))
import safetensors_io as st

TICK = 1 / os.sysconf("SC_CLK_TCK")
CORES = len(os.sched_getaffinity(0))
ARCHS = ["densegats", "multiresgnet", "clothnet"]
TOLERANCE = 1e-4


def busy():
    """seconds of all processors so far: user, nice, system, irq, softirq, stolen"""
    with open("/proc/stat") as f:
        v = [int(x) for x in f.readline().split()[1:9]]
    return (v[0] + v[1] + v[2] + v[5] + v[6] + v[7]) * TICK


class Peer:
    def __init__(self, name, command):
        self.name, self.times, self.processor = name, [], []  # ms of runs that counted, processor ms of all
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.version = self.answer().split()[1]

    def answer(self):
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"{self.name} stopped: exit code {self.process.wait()}")
        return line.strip()

    def ask(self, what):
        self.process.stdin.write(what + "\n")
        self.process.stdin.flush()
        return self.answer()

    def own(self):
        """seconds its threads ran, and seconds they waited for a processor"""
        ran = waited = 0
        for task in os.listdir(f"/proc/{self.process.pid}/task"):
            with open(f"/proc/{self.process.pid}/task/{task}/schedstat") as f:
                a, b, _ = f.read().split()
            ran, waited = ran + int(a) * 1e-9, waited + int(b) * 1e-9
        return ran, waited

    def turn(self, count, noise):
        for k in range(count + 1):
            self.ask("prepare")
            before, (ran, waited), start = busy(), self.own(), time.monotonic()
            ms = float(self.ask("run"))
            took = time.monotonic() - start
            now, (ran2, waited2) = busy(), self.own()
            if k == 0:
                continue
            self.processor.append(1e3 * (ran2 - ran))
            others = now - before - (ran2 - ran)
            if others <= noise * took * CORES + TICK * CORES and waited2 - waited <= noise * took:
                self.times.append(ms)

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def prepare(o, arch):
    """the files of one network; the others' answers against deformnet's"""
    path = lambda end: os.path.join(o.work, end)
    run = lambda *command: subprocess.run(command, check=True)
    python = sys.executable
    run(python, os.path.join(HERE, "make_case.py"), "--arch", arch, "--out", o.work, *(["--shuffle"] if o.shuffle else []))
    model, network, onnx = path(f"{arch}.model.safetensors"), path(f"{arch}.network.safetensors"), path(f"{arch}.onnx")
    run(o.bench, model, path(f"{arch}.case.safetensors"), "2", "--write", network)
    run(python, os.path.join(HERE, "export_onnx.py"), model, network, onnx)
    run("node", os.path.join(HERE, "bench_ort.mjs"), o.work, onnx, network, "2", "--write", path(f"{arch}.ort"))
    if o.torch:
        run(python, os.path.join(HERE, "bench_torch.py"), model, network, "2", "--write", path(f"{arch}.torch"))
    ours = st.load(network)[0]["displacement"]
    largest = float(np.abs(ours).max())
    for name, end in [("ONNX Runtime", "ort")] + ([("PyTorch", "torch")] if o.torch else []):
        worst = float(np.abs(ours - np.fromfile(path(f"{arch}.{end}"), np.float32).reshape(ours.shape)).max())
        print(f"{arch}: {name} differs by at most {worst:.2e} m, {worst / largest:.1e} of the largest displacement", flush=True)
        if not worst <= TOLERANCE * largest:  # NaN fails too
            raise SystemExit(f"{arch}: the outputs do not agree")


def measure(o, arch, threads):
    path = lambda end: os.path.join(o.work, end)
    network = path(f"{arch}.network.safetensors")
    peers = [Peer("deformnet", [o.bench, path(f"{arch}.model.safetensors"), path(f"{arch}.case.safetensors"), str(threads)]),
             Peer("ONNX Runtime", ["node", os.path.join(HERE, "bench_ort.mjs"), o.work, path(f"{arch}.onnx"), network,
                                   str(threads)])]
    if o.torch:
        peers.append(Peer("PyTorch", [sys.executable, os.path.join(HERE, "bench_torch.py"), path(f"{arch}.model.safetensors"),
                                      network, str(threads)]))
    end = time.monotonic() + o.seconds
    while time.monotonic() < end and min(len(p.times) for p in peers) < o.runs:
        for p in peers:
            p.turn(3, o.noise)
    for p in peers:
        p.close()
    return peers


def main():
    o = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    o.add_argument("--work", default=os.path.join(HERE, "..", "build", "peers"), help="holds node_modules; files go there")
    o.add_argument("--bench", default=os.path.join(HERE, "..", "build", "bench_deformnet"))
    o.add_argument("--arch", action="append", choices=ARCHS)
    o.add_argument("--threads", action="append", type=int)
    o.add_argument("--runs", type=int, default=20, help="quiet runs wanted of each peer")
    o.add_argument("--seconds", type=float, default=90, help="to look for them, for each network and number of threads")
    o.add_argument("--noise", type=float, default=0.05)
    o.add_argument("--no-torch", dest="torch", action="store_false", help="without PyTorch, the slowest of the three")
    o.add_argument("--shuffle", action="store_true", help="vertices in random order")
    o.add_argument("--kept", action="store_true", help="measure with the files of the last call")
    o.add_argument("--json")
    o = o.parse_args()
    archs, threads = o.arch or ARCHS, o.threads or [2, 1]
    results, failed = [], False
    if not o.kept:
        for arch in archs:
            prepare(o, arch)
    middle = lambda a: float(np.median(a)) if a else None
    text = lambda x, form: format(x, form) if x is not None else "-"
    print(f"\n{'':22}  {'':22}{'quiet runs, ms':>19}{'':21}{'processor ms':>14}")
    print(f"{'network':14}{'threads':>8}  {'library':22}{'median':>10}{'least':>9}{'counted':>12}{'ratio':>9}{'median':>14}{'ratio':>8}")
    for arch in archs:
        for n in threads:
            peers = measure(o, arch, n)
            wall, processor = middle(peers[0].times), middle(peers[0].processor)
            for p in peers:
                r = {"network": arch, "threads": n, "library": f"{p.name} {p.version}", "median_ms": middle(p.times),
                     "least_ms": min(p.times, default=None), "counted": len(p.times), "made": len(p.processor),
                     "ratio": middle(p.times) / wall if wall and p.times else None, "processor_ms": middle(p.processor),
                     "processor_ratio": middle(p.processor) / processor}
                print(f"{arch:14}{n:8}  {r['library']:22}{text(r['median_ms'], '.1f'):>10}{text(r['least_ms'], '.1f'):>9}"
                      f"{r['counted']:6} of {r['made']:2}{text(r['ratio'], '.2f'):>9}{r['processor_ms']:14.1f}"
                      f"{r['processor_ratio']:8.2f}", flush=True)
                results.append(r)
                failed |= not p.times
    if o.json:
        with open(o.json, "w") as f:
            json.dump(results, f, indent=1)
    if failed:
        raise SystemExit("other processes were busy during every run of some peer: try again when the machine is quiet")


if __name__ == "__main__":
    main()
