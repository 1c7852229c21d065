// Lines over x, and how uPlot draws them.
import uPlot from 'uplot';
import { decimalsOf, fixed, significant } from './numbers';

export type Line = {
  label: string;
  color: string;
  values: ArrayLike<number>;
  kind?: 'line' | 'dots';
  dash?: readonly number[];
  width?: number;
  // Ends of an interval of 95 %.
  band?: { low: ArrayLike<number>; high: ArrayLike<number> };
};

// Half-width of an interval of 95 %, in standard errors.
export const WIDE = 1.96;

// The interval of values with these standard errors, if there are any.
export function banded(values: readonly number[], stdErrors: readonly number[]): Pick<Line, 'values' | 'band'> {
  if (!values.length || stdErrors.length !== values.length) return { values };
  const ends = (sign: number): number[] => values.map((v, i) => v + sign * WIDE * stdErrors[i]!);
  return { values, band: { low: ends(-1), high: ends(1) } };
}

export function shapeOf(lines: readonly Line[]): string {
  return lines.map((l) => [l.label, l.color, l.kind, l.dash, l.width, Boolean(l.band)].join('|')).join('\n');
}

// Columns of uPlot. NaN becomes null, since it would spoil the range of the axis.
export function columns(x: ArrayLike<number>, lines: readonly Line[]): uPlot.AlignedData {
  const there = (values: ArrayLike<number>): (number | null)[] => Array.from(values, (v) => (Number.isFinite(v) ? v : null));
  const all = [there(x)];
  for (const line of lines) {
    if (line.band) all.push(there(line.band.high), there(line.band.low));
    all.push(there(line.values));
  }
  return all as uPlot.AlignedData;
}

function look(line: Line, bars: boolean): uPlot.Series {
  const dots = line.kind === 'dots';
  const series: uPlot.Series = {
    label: line.label,
    stroke: line.color,
    width: dots ? 0 : (line.width ?? 1.75),
    points: dots ? { show: true, size: 3.5, fill: line.color, width: 0 } : { show: false },
  };
  if (line.dash?.length) series.dash = [...line.dash];
  if (bars && uPlot.paths.bars) {
    series.paths = uPlot.paths.bars({ size: [0.9, Infinity] });
    series.fill = `${line.color}88`;
  }
  return series;
}

// Bars start at zero, and the first and the last are as wide as the others.
function barScales(x: ArrayLike<number>): uPlot.Scales {
  const half = ((x[1] ?? 1) - (x[0] ?? 0)) / 2;
  return {
    x: { time: false, range: (_, low, high) => [low - half, high + half] },
    y: { range: (_, _low, high) => [0, high > 0 ? 1.05 * high : 1] },
  };
}

export type Chart = {
  x: ArrayLike<number>;
  lines: readonly Line[];
  xLabel: string;
  yLabel: string;
  width: number;
  height: number;
  bars: boolean;
  // Takes the index that is pointed at.
  onpoint: (at: number | null) => void;
};

export function optionsOf(chart: Chart): uPlot.Options {
  const style = getComputedStyle(document.documentElement);
  const [ink, grid] = [style.getPropertyValue('--soft').trim(), style.getPropertyValue('--line').trim()];
  const series: uPlot.Series[] = [{}];
  const bands: uPlot.Band[] = [];
  for (const line of chart.lines) {
    if (line.band) {
      const edge: uPlot.Series = { show: true, width: 0, points: { show: false } };
      bands.push({ series: [series.length, series.length + 1], fill: `${line.color}44` });
      series.push(edge, { ...edge });
    }
    series.push(look(line, chart.bars));
  }
  const values = (_: uPlot, ticks: number[]): string[] => ticks.map((v) => significant(v, 4));
  const axis = { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 }, labelSize: 22, values };
  return {
    width: chart.width,
    height: chart.height,
    series,
    bands,
    pxAlign: 0,
    padding: [8, null, null, null],
    legend: { show: false },
    cursor: { y: false, drag: { x: false, y: false }, points: { show: false } },
    hooks: { setCursor: [(plot) => chart.onpoint(plot.cursor.idx ?? null)] },
    scales: chart.bars ? barScales(chart.x) : { x: { time: false } },
    axes: [
      { ...axis, label: chart.xLabel, size: 38 },
      { ...axis, label: chart.yLabel, size: 58, space: (_plot, _axis, _low, _high, length) => Math.max(24, length / 8) },
    ],
  };
}

// Numbers of a line: to a tenth of their error if it has a band, or with four digits of the largest.
export function format(line: Line): (value: number) => string {
  const values = Array.from(line.values).filter(Number.isFinite);
  if (new Set(values).size === 1) return (value) => significant(value, 4);
  const decimals = line.band ? decimalsOf(meanHalf(line.band) / WIDE) : decimalsOf(largest(values) / 100);
  return (value) => fixed(value, decimals);
}

export function formatX(x: ArrayLike<number>): (value: number) => string {
  const decimals = decimalsOf(Math.abs((x[1] ?? 1) - (x[0] ?? 0)));
  return (value) => fixed(value, decimals);
}

const largest = (values: number[]): number => values.reduce((most, v) => Math.max(most, Math.abs(v)), 0);

function meanHalf({ low, high }: NonNullable<Line['band']>): number {
  const widths = Array.from(low, (v, i) => (high[i]! - v) / 2).filter(Number.isFinite);
  return widths.reduce((sum, v) => sum + v, 0) / Math.max(1, widths.length);
}

// The value at an index, or at the nearest one that has a value: lines may be on coarser pixels than the axis.
export function valueNear(values: ArrayLike<number>, at: number, reach = 2): number {
  for (let d = 0; d <= reach; d++) {
    for (const i of [at - d, at + d]) if (Number.isFinite(values[i])) return values[i]!;
  }
  return NaN;
}
