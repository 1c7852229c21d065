// Generates src/gen, the page's clients, from descriptors on standard input (cargo run -p farm-proto --example descriptors).
import { spawnSync } from 'node:child_process';
import { mkdirSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { create, fromBinary, toBinary } from '@bufbuild/protobuf';
import { CodeGeneratorRequestSchema, CodeGeneratorResponseSchema, FileDescriptorSetSchema } from '@bufbuild/protobuf/wkt';

const OUT = 'src/gen';
const { file: protoFile } = fromBinary(FileDescriptorSetSchema, readFileSync(0));
const fileToGenerate = protoFile.map(({ name }) => name);
const request = create(CodeGeneratorRequestSchema, { fileToGenerate, protoFile, parameter: 'target=ts' });
const plugin = spawnSync('node_modules/.bin/protoc-gen-es', { input: toBinary(CodeGeneratorRequestSchema, request) });
if (plugin.status !== 0) throw new Error(`protoc-gen-es: ${plugin.error ?? plugin.stderr}`);
const response = fromBinary(CodeGeneratorResponseSchema, plugin.stdout);
if (response.error) throw new Error(response.error);
rmSync(OUT, { recursive: true, force: true });
for (const { name, content } of response.file) {
  const path = join(OUT, name);
  mkdirSync(dirname(path), { recursive: true });
  writeFileSync(path, content);
}
