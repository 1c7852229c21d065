// Places along an axis whose nodes have cells of equal width, 0 to n: the middle of cell i is i + 1/2.
type Axis = readonly number[];

export function placeOf(axis: Axis, value: number): number {
  const n = axis.length;
  if (n < 2) return 0.5;
  let i = axis.findIndex((node) => node >= value);
  if (i < 0) i = n - 1;
  i = Math.max(1, i);
  const [a, b] = [axis[i - 1]!, axis[i]!];
  return Math.min(n - 0.5, Math.max(0.5, i - 1 + (value - a) / (b - a) + 0.5));
}

export function valueAt(axis: Axis, place: number): number {
  const n = axis.length;
  if (n < 2) return axis[0]!;
  const i = Math.min(n - 1, Math.max(0, place - 0.5));
  const low = Math.min(n - 2, Math.floor(i));
  return axis[low]! + (i - low) * (axis[low + 1]! - axis[low]!);
}

// The cell of a place.
export function cellAt(axis: Axis, place: number): number {
  return Math.min(axis.length - 1, Math.max(0, Math.floor(place)));
}

// Whether a value is that of its cell's node, apart from rounding in links.
export function isNode(axis: Axis, value: number): boolean {
  const place = placeOf(axis, value);
  return Math.abs(place - cellAt(axis, place) - 0.5) < 1e-3;
}

// The next node above or below a value.
export function nextNode(axis: Axis, value: number, by: 1 | -1): number {
  const i = placeOf(axis, value) - 0.5;
  const to = by > 0 ? Math.floor(i + 1e-3) + 1 : Math.ceil(i - 1e-3) - 1;
  return axis[Math.min(axis.length - 1, Math.max(0, to))]!;
}

// Nodes for ticks, with the shares of the axis at which they lie; short axes have fewer.
export function ticksOf(axis: Axis, text: (value: number) => string, count = 5): { share: number; text: string }[] {
  const shares = Array.from({ length: count }, (_, i) => i / (count - 1));
  return [...new Set(shares.map((share) => Math.round(share * (axis.length - 1))))].map((i) => ({
    share: (i + 0.5) / axis.length,
    text: text(axis[i]!),
  }));
}
