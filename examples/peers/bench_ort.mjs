/*  bench_ort.mjs - times ONNX Runtime on one case, one run for each line on standard input; as bench_deformnet.c
    usage     node bench_ort.mjs MODULES MODEL.onnx CASE.network THREADS [--write FILE]
              MODULES holds node_modules/onnxruntime-node
    --write   runs once and leaves the displacement as raw float32 */
import { createRequire } from 'node:module';
import { createInterface } from 'node:readline';
import { readFileSync, writeFileSync } from 'node:fs';
import { resolve } from 'node:path';

const [modules, modelPath, casePath, threads, , writePath] = process.argv.slice(2);
const ort = createRequire(resolve(modules) + '/')('onnxruntime-node');

function tensor(path, name) { // one F32 tensor of a safetensors file
   const bytes = readFileSync(path);
   const size = Number(bytes.readBigUInt64LE(0));
   const { dtype, shape, data_offsets: [first, last] } = JSON.parse(bytes.toString('utf8', 8, 8 + size))[name];
   if (dtype !== 'F32') throw new Error(`${path}: ${name} is ${dtype}`);
   const data = bytes.buffer.slice(bytes.byteOffset + 8 + size + first, bytes.byteOffset + 8 + size + last);
   return new ort.Tensor('float32', new Float32Array(data), shape);
}

const session = await ort.InferenceSession.create(modelPath, {
   executionProviders: ['cpu'], intraOpNumThreads: Number(threads), interOpNumThreads: 1,
   executionMode: 'sequential', graphOptimizationLevel: 'all', logSeverityLevel: 3,
   extra: { session: { force_spinning_stop: '1' } } // threads spin within a run, but leave the processor to the next peer
});
const feeds = Object.fromEntries(session.inputNames.map(name => [name, tensor(casePath, name)]));
if (writePath) {
   const { data } = (await session.run(feeds)).displacement;
   writeFileSync(writePath, Buffer.from(data.buffer, data.byteOffset, data.byteLength));
   process.exit(0);
}
const version = createRequire(resolve(modules) + '/')('onnxruntime-node/package.json').version;
console.log(`ready ${version}`);
for await (const line of createInterface({ input: process.stdin })) {
   if (line === 'prepare') console.log('prepared');
   else if (line === 'run') {
      const start = process.hrtime.bigint();
      await session.run(feeds);
      console.log((Number(process.hrtime.bigint() - start) / 1e6).toFixed(4));
   } else throw new Error(`expected prepare or run, got ${line}`);
}
