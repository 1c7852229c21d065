// The curves of one profile: measured values, the medium under the crosshair, and the best fit.
import type { PixelRow, ProfileResponse } from '../gen/farm/v1/fits_pb';
import type { FitCurves } from './ask';
import { banded, type Line } from './chart';
import { COLORS, dash } from './colors';
import { shownDerivative } from './wavelet';

export type Curves = { x: ArrayLike<number>; lines: Line[] };
// Wavelet and level of a fit.
type Slope = { wavelet: string; level: number };

// Pixels per mm to which gradients of fits refer.
const PER_MM = 360 / 10;

const centre = (row: PixelRow | undefined, i: number): number => (row ? row.fromMm + (i + 0.5) * row.pitchMm : i);

export function centresOf(profile: ProfileResponse): Float64Array {
  return Float64Array.from({ length: profile.channels[0]?.values.length ?? 0 }, (_, i) => centre(profile.pixels, i));
}

// Measured values on the dictionary's pixels, with those that the medium would have.
export function profileCurves(profile: ProfileResponse, fit: FitCurves | undefined, factor: number): Curves {
  const x = centresOf(profile);
  const measured = new Float64Array(x.length).fill(NaN);
  const row = profile.pixels;
  fit?.x_mm.forEach((at, i) => {
    const place = row ? Math.round((at - row.fromMm) / row.pitchMm - 0.5) : -1;
    if (place >= 0 && place < x.length) measured[place] = factor * (fit.measured.values[i] ?? NaN);
  });
  const { values = [], stdErrors = [] } = profile.channels[0] ?? {};
  const lines: Line[] = [
    { label: 'measured', color: COLORS[0], kind: 'dots', values: measured },
    { label: 'this medium', color: COLORS[1], ...banded(values, stdErrors) },
  ];
  return { x, lines };
}

// Gradients on the pixels that the fit compared, since their smoothing depends on the pixels.
export function gradientCurves(profile: ProfileResponse, fit: FitCurves, factor: number, slope: Slope): Curves {
  const pitch = (fit.x_mm.at(-1)! - fit.x_mm[0]!) / (fit.x_mm.length - 1);
  const values = averages(profile, fit.x_mm, pitch);
  const own = shownDerivative(values, slope.wavelet, slope.level).map((v) => Math.abs(v) / pitch);
  const best = (fit.refined ?? fit.candidates[0])?.gradient ?? [];
  const lines: Line[] = [
    { label: 'measured', color: COLORS[0], kind: 'dots', values: fit.measured.gradient.map((v) => v * PER_MM * factor) },
    { label: 'this medium', color: COLORS[1], values: own },
    { label: 'best fit', color: COLORS[2], dash: dash(1), values: best.map((v) => v * PER_MM) },
  ];
  // Derivatives are half a pixel to the right of the pixels' centres.
  return { x: fit.x_mm.map((x) => x + pitch / 2), lines };
}

// Residuals of the best fit, which are over their errors: no factor applies.
export function residualCurves(fit: FitCurves): Curves {
  const level = (value: number): Line => ({
    label: `${value < 0 ? '−' : '+'}2 σ`,
    color: COLORS[2],
    dash: dash(value < 0 ? 2 : 1),
    values: fit.x_mm.map(() => value),
  });
  return { x: fit.x_mm, lines: [{ label: 'best fit', color: COLORS[0], kind: 'dots', values: fit.residuals }, level(-2), level(2)] };
}

// Averages of a predicted profile over pixels with these centres, from its integral between its own pixels' edges.
function averages(profile: ProfileResponse, xMm: readonly number[], pitchMm: number): number[] {
  const values = profile.channels[0]?.values ?? [];
  const row = profile.pixels;
  const integral = [0];
  for (const value of values) integral.push(integral.at(-1)! + value);
  const upTo = (x: number): number => {
    const place = row ? Math.min(values.length, Math.max(0, (x - row.fromMm) / row.pitchMm)) : 0;
    const below = Math.min(values.length - 1, Math.floor(place));
    return integral[below]! + (place - below) * values[below]!;
  };
  const width = pitchMm / (row?.pitchMm ?? 1);
  return xMm.map((x) => (upTo(x + pitchMm / 2) - upTo(x - pitchMm / 2)) / width);
}
