// The derivative of a profile by an undecimated wavelet transform, as the fit shows it (optics/fit, dictionary/gradient).

const R = Math.SQRT2;
const HAAR = { low: [1 / R, 1 / R], high: [-1 / R, 1 / R], scale: 4 };
const SPLINE = { low: [R / 8, (3 * R) / 8, (3 * R) / 8, R / 8], high: [-2 * R, 2 * R], scale: 1 };

// Derivative per sample at i + 1/2, right also at the ends: the profile is continued beyond them by point reflection.
export function shownDerivative(f: number[], wavelet: string, level: number): number[] {
  const beyond = Math.min(4 << level, f.length - 1);
  const line = Math.min(1 << level, beyond);
  const before = carriedOn(f.toReversed(), beyond, line).reverse();
  return derivative([...before, ...f, ...carriedOn(f, beyond, line)], wavelet, level).slice(beyond, beyond + f.length);
}

// The chord between the ends is subtracted before, and its slope added afterwards.
export function derivative(f: number[], wavelet: string, level: number): number[] {
  const n = f.length;
  const slope = (f[n - 1]! - f[0]!) / (n - 1);
  const { low, high, scale } = wavelet === 'haar' ? HAAR : SPLINE;
  let y = f.map((v, i) => v - f[0]! - slope * i);
  for (let stage = 1; stage <= level; stage++) y = convolved(y, stage < level ? low : high, 1 << (stage - 1));
  const offset = Math.ceil((y.length - n) / 2);
  const factor = scale / 2 ** (1.5 * level);
  return y.slice(offset, offset + n).map((v) => slope - factor * v);
}

// Full convolution, the taps being `spacing` apart.
function convolved(x: number[], taps: number[], spacing: number): number[] {
  const y = new Array<number>(x.length + (taps.length - 1) * spacing).fill(0);
  taps.forEach((tap, k) => x.forEach((v, i) => (y[i + k * spacing]! += tap * v)));
  return y;
}

// The pixels that continue a profile at its end, where a straight line fits its last ones.
function carriedOn(f: number[], count: number, line: number): number[] {
  const last = f.slice(-1 - line);
  const mean = last.reduce((sum, v) => sum + v, 0) / last.length;
  let [product, square] = [0, 0];
  last.forEach((v, i) => {
    const x = i - line / 2;
    product += x * (v - mean);
    square += x * x;
  });
  const end = mean + ((line / 2) * product) / Math.max(square, Number.MIN_VALUE);
  return f.toReversed().slice(1, count + 1).map((v) => 2 * end - v);
}
