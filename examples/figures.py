#!/usr/bin/env python3
"""figures.py - the README's performance tables, from what the two benchmarks measured

run       make -C examples bench && make -C examples peers && make -C examples figures
          or    python3 figures.py build/bench.json build/peers.json ../README.md
writes    what stands between the README's lines <!-- figures --> and <!-- /figures -->; all else stays as it is
"""
import json
import sys

BEGIN, END = "<!-- figures -->\n", "<!-- /figures -->\n"


def table(head, rows):
    aligned = ["---" if k == 0 else "---:" for k in range(len(head))]
    return "".join("| " + " | ".join(line) + " |\n" for line in [head, aligned] + rows) + "\n"


def mb(x):
    return f"{x / 1e6:.1f}"


def bench_tables(items):
    about = lambda kind: [x for x in items if x["about"] == kind]
    run, = about("run")
    out = (f"`make -C examples bench` ({run['threads']:.0f} threads, {run['kernel']}; peaks measured in the run, GFLOP/s on all threads: float32 "
           f"{run['peak_f32_all_gflops']:.0f}, bf16 {run['peak_bf16_all_gflops']:.0f}, int8 {run['peak_int8_all_gflops']:.0f}; "
           f"{run['counted']:.0f} of {run['made']:.0f} runs were quiet and count). Medians of a frame, batch 1, from palette to normals:\n\n")
    rows = []
    for n in about("network"):
        share = n.get("products_share_of_peak")
        rows.append([f"{n['subject']}, {n['precision']}, {n['nodes']:,.0f}", f"{n['skin_ms']:.2f}", f"{n['features_ms']:.2f}", f"{n['network_ms']:.1f}",
                     f"{n['normals_ms']:.2f}", f"{n['frame_ms']:.1f}", f"{n['cold_frame_ms']:.1f}", f"{n['network_gflops']:.0f}",
                     f"{100 * share:.0f} %" if share else "-", f"{mb(n['model_bytes'])} + {mb(n['rig_bytes'])} + {mb(n['scratch_bytes'])}"])
    for n in about("garment"):
        rows.append([f"{n['subject']}, {n['precision']}, {n['nodes']:,.0f}", f"{n['follow_ms']:.2f}", "-", f"{n['coarse_ms'] + n['detail_ms']:.1f}",
                     f"{n['output_ms']:.2f}", f"{n['frame_ms']:.1f}", "-", "-", "-", f"{mb(n['model_bytes'])} + {mb(n['garment_bytes'])} + {mb(n['scratch_bytes'])}"])
    out += table(["network, precision, nodes", "skin ms", "features", "network", "normals", "**frame**", "cold", "GFLOP/s", "products alone, of the peak",
                  "model + rig + scratch, MB"], rows)
    rows = [[f"{p['subject']}, {p['precision']}", f"{p['frame_ms']:.1f}", f"{p['of_f32']:.2f}", f"{100 * p['error']:.2g} %" if p["error"] else "-",
             mb(p["model_bytes"]), mb(p["scratch_bytes"])] for p in about("precision")]
    out += "The precisions in turns, and how far their displacements are from float32's (mean over mean, random weights):\n\n"
    out += table(["network, precision", "frame ms", "of float32", "off", "model MB", "scratch MB"], rows)
    sizes = about("size")
    if sizes:
        out += f"`{sizes[0]['subject']}` against the number of nodes: " + ", ".join(f"{s['nodes']:,.0f}: {s['ns_per_node'] / 1e3:.2f}" for s in sizes) + " µs a node.\n\n"
    return out, [[x["subject"], x["wanted"], x["found"], x["verdict"]] for x in about("bar") if x["wanted"]]


def peers_table(items):
    """a row a network: every library's two-thread median, and ONNX Runtime's over it"""
    runs = [x for x in items if "network" in x and x["median_ms"] is not None and x["threads"] == 2]
    name = lambda x: x["library"].split("-")[0].replace("deformnet ", "")
    libraries = list(dict.fromkeys(name(x) for x in runs))
    rows = []
    for network in dict.fromkeys(x["network"] for x in runs):
        found = {name(x): x for x in runs if x["network"] == network}
        rows.append([network] + [f"{found[k]['median_ms']:.1f} ({found[k]['onnx_over_it']:.2f})" if k in found else "-" for k in libraries])
    out = ("`make -C examples peers`: the same weights, mesh and inputs, network only, in turns, two threads; median ms and, in brackets, ONNX Runtime's time over "
           "it. deformnet's figure is `dn_stage_network` on rows given; what the pose-independent columns add to the first layer was summed at bind "
           "(clothnet's holds its rows too):\n\n")
    return (out + table(["network"] + libraries, rows),
            [[f"{x['bar']}: float32 against ONNX Runtime float32", f">= {x['wanted']}", f"{x['found']:.2f}", x["verdict"]] for x in items if "bar" in x])


def main():
    if len(sys.argv) != 4:
        raise SystemExit("usage: figures.py BENCH.json PEERS.json README.md")
    bench, peers = (json.load(open(path)) for path in sys.argv[1:3])
    text = open(sys.argv[3], encoding="utf-8").read()
    before, rest = text.split(BEGIN, 1)
    after = rest.split(END, 1)[1]
    ours, bars = bench_tables(bench)
    others, more = peers_table(peers)
    with open(sys.argv[3], "w", encoding="utf-8") as f:
        f.write(before + BEGIN + "\n" + ours + others + "Against the bars:\n\n" + table(["bar", "wanted", "found", ""], more + bars) + END + after)


if __name__ == "__main__":
    main()
