// Draws a map of distances: its cells and the lines between them.
import { contours } from 'd3-contour';
import type { DistanceMap } from './ask';
import { near, NO_DATA } from './colors';
import { cellAt, isNode, placeOf } from './nodes';
import { albedo as albedoText, significant } from './numbers';

export type Point = { sigmaT: number; albedo: number };

// Lines at these multiples of the smallest distance.
export const LINES = [1.25, 2, 4, 8];
// Cells at and above this multiple have the darkest colour.
export const FARTHEST = 30;

// The smallest distance over all layers.
export function leastOf(map: DistanceMap): number {
  return Math.max(1e-12, Math.min(...map.layers.map((layer) => layer.best.error)));
}

export function colorOf(ratio: number): [number, number, number] {
  return Number.isFinite(ratio) ? near(Math.log(ratio) / Math.log(FARTHEST)) : NO_DATA;
}

// Distances over the smallest, as in figures of farmctl and in Python: 1 − α to the right, σ_t up. Rows begin with the
// greatest σ_t, columns with the greatest albedo.
export function uprightOf(map: DistanceMap, layer: number, least: number): Float64Array {
  const [rows, columns] = [map.sigma_t_per_mm.length, map.albedo.length];
  const errors = map.layers[layer]?.errors.flat() ?? [];
  return Float64Array.from({ length: rows * columns }, (_, i) => (errors[rows * columns - 1 - i] ?? NaN) / least);
}

export function paintCells(canvas: HTMLCanvasElement, ratios: Float64Array, columns: number): void {
  const context = canvas.getContext('2d');
  if (!context) return;
  canvas.width = columns;
  canvas.height = ratios.length / columns;
  const image = context.createImageData(canvas.width, canvas.height);
  ratios.forEach((ratio, i) => image.data.set([...colorOf(ratio), 255], 4 * i));
  context.putImageData(image, 0, 0);
}

export function paintLines(canvas: HTMLCanvasElement, ratios: Float64Array, columns: number, width: number, height: number): void {
  const context = canvas.getContext('2d');
  if (!context || width === 0 || height === 0) return;
  const rows = ratios.length / columns;
  const fine = window.devicePixelRatio || 1;
  canvas.width = width * fine;
  canvas.height = height * fine;
  const path = new Path2D();
  const [w, h] = [canvas.width / columns, canvas.height / rows];
  const shape = contours().size([columns + 2, rows + 2]).smooth(true).thresholds(LINES.map(Math.log));
  for (const ring of shape(bordered(ratios, columns, rows)).flatMap(({ coordinates }) => coordinates.flat())) {
    ring.forEach(([x, y], i) => (i === 0 ? path.moveTo((x! - 1) * w, (y! - 1) * h) : path.lineTo((x! - 1) * w, (y! - 1) * h)));
  }
  context.lineWidth = 1.2 * fine;
  context.strokeStyle = '#ffffffcc';
  context.stroke(path);
}

// Logarithms with the cells of the border repeated: lines then leave the map where they meet its border.
function bordered(ratios: Float64Array, columns: number, rows: number): number[] {
  const within = (i: number, n: number): number => Math.min(n - 1, Math.max(0, i - 1));
  return Array.from({ length: (columns + 2) * (rows + 2) }, (_, i) => {
    const [column, row] = [within(i % (columns + 2), columns), within(Math.floor(i / (columns + 2)), rows)];
    const ratio = ratios[row * columns + column]!;
    return Number.isFinite(ratio) ? Math.log(ratio) : Infinity;
  });
}

const mediumText = ({ sigmaT, albedo }: Point): string =>
  `σ_t ${significant(sigmaT)} /mm, α ${albedoText(albedo)} (1 − α ${significant(1 - albedo, 2)})`;

type Shown = { map: DistanceMap; layer: number; least: number; quantity: string };

// The value of the cell at a point: with the cell's medium, or with the point itself and the record that it belongs to.
export function cellText({ map, layer, least, quantity }: Shown, point: Point, own: boolean): string {
  const s = cellAt(map.sigma_t_per_mm, placeOf(map.sigma_t_per_mm, point.sigmaT));
  const a = cellAt(map.albedo, placeOf(map.albedo, point.albedo));
  const record = { sigmaT: map.sigma_t_per_mm[s]!, albedo: map.albedo[a]! };
  const error = map.layers[layer]?.errors[s]?.[a] ?? NaN;
  const ratio = `${quantity} ${significant(error)} (${significant(error / least)} × the smallest)`;
  const value = Number.isFinite(error) ? ratio : `no ${quantity}`;
  if (!own) return `${mediumText(record)}, ${value}`;
  const isRecord = isNode(map.sigma_t_per_mm, point.sigmaT) && isNode(map.albedo, point.albedo);
  const from = isRecord ? '' : `; that of the record ${mediumText(record)}, g ${significant(map.layers[layer]?.g ?? 0)}`;
  return `${mediumText(point)}, ${value}${from}`;
}
