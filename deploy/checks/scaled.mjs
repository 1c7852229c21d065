// Compares KEDA's objects among rendered ones (a JSON array on standard input) with KEDA's schema.
//
// usage: node scaled.mjs FOLDER      with @kubernetes-models/keda below FOLDER

import { createRequire } from 'node:module';
import { text } from 'node:stream/consumers';

const require = createRequire(`${process.argv[2]}/`);
// Loaded by its path, since the package's classes validate copies of the objects.
const { validate } = require('./node_modules/@kubernetes-models/keda/_schemas/KedaShV1alpha1ScaledObject.js');

// The schema accepts unknown fields, and a cluster silently drops them. A validator reads all fields of its schema, so
// fields that it does not read are unknown.
function watched(value, path, unseen) {
  if (value === null || typeof value !== 'object') return value;
  const keys = Array.isArray(value) ? [] : Object.keys(value);
  keys.forEach((key) => unseen.add(`${path}.${key}`));
  const copies = new Map();
  return new Proxy(value, {
    get(target, key) {
      if (typeof key === 'symbol' || !Object.hasOwn(target, key)) return target[key];
      unseen.delete(`${path}.${key}`);
      if (!copies.has(key)) copies.set(key, watched(target[key], `${path}.${key}`, unseen));
      return copies.get(key);
    },
  });
}

const objects = JSON.parse(await text(process.stdin)).filter((object) => object?.apiVersion === 'keda.sh/v1alpha1');
if (objects.length === 0) throw new Error('there is no object of KEDA');
for (const object of objects) {
  const name = `${object.kind} ${object.metadata.name}`;
  if (object.kind !== 'ScaledObject') throw new Error(`${name}: only a ScaledObject is known here`);
  const unseen = new Set();
  const { spec, ...others } = object;
  if (!validate({ ...others, spec: watched(spec, 'spec', unseen) })) {
    throw new Error(`${name}: ${validate.errors.map((error) => `${error.instancePath} must hold "${error.keyword}"`).join(', ')}`);
  }
  if (unseen.size > 0) throw new Error(`${name}: unknown: ${[...unseen].join(', ')}`);
  console.log(`${name} follows the schema of KEDA`);
}
