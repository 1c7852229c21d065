// The jobs of a dictionary as cells: columns are σ_t, index by index; rows are g, thickness by thickness.
import { JobState } from '../gen/farm/v1/dictionaries_pb';
import type { Grid } from '../gen/farm/v1/model_pb';
import { albedo as albedoText, counted, significant } from './numbers';

export const JOB_STATES: readonly { state: JobState; name: string; color: string }[] = [
  { state: JobState.WAITING, name: 'waiting', color: '--waiting' },
  { state: JobState.COMPUTING, name: 'computing', color: '--computing' },
  { state: JobState.DONE, name: 'done', color: '--done' },
  { state: JobState.CHECKED, name: 'checked by the coordinator', color: '--checked' },
  { state: JobState.FAILED, name: 'failed', color: '--failed' },
];

export type Cell = { row: number; column: number };

// Jobs are numbered with the thickness running fastest, then g, then σ_t, then the index.
export function jobAt(grid: Grid, { row, column }: Cell): number {
  const g = grid.g.length;
  return (column * g + (row % g)) * grid.thicknessMm.length + Math.floor(row / g);
}

// The transport point of a cell's job, its records and its state.
export function jobText(grid: Grid, cell: Cell, states: Uint8Array): string {
  const [sigmas, g] = [grid.sigmaTPerMm, grid.g];
  const job = jobAt(grid, cell);
  const point = [
    `σ_t ${significant(sigmas[cell.column % sigmas.length] ?? NaN)} /mm`,
    `g ${significant(g[cell.row % g.length] ?? NaN)}`,
    `${significant(grid.thicknessMm[Math.floor(cell.row / g.length)] ?? NaN)} mm`,
  ];
  if (grid.sampleIor.length > 1) point.push(`index ${significant(grid.sampleIor[Math.floor(cell.column / sigmas.length)] ?? NaN, 4)}`);
  const name = JOB_STATES[(states[job] ?? 0) - 1]?.name ?? 'unknown';
  const albedos = grid.albedo.length > 1 ? `, α ${albedoText(grid.albedo[0]!)} to ${albedoText(grid.albedo.at(-1)!)}` : '';
  return `job ${job}: ${name}; ${point.join(', ')}; ${counted(grid.albedo.length, 'record')}${albedos}`;
}

type Colors = { fill: string[]; paper: string };

export function stateColors(): Colors {
  const style = getComputedStyle(document.documentElement);
  const named = (name: string): string => style.getPropertyValue(name).trim();
  return { fill: JOB_STATES.map(({ color }) => named(color)), paper: named('--sheet') };
}

// A cell of at least seven pixels: its colour, and a sign that needs no colour.
export function paintCell(context: CanvasRenderingContext2D, state: JobState, box: [number, number, number, number], { fill, paper }: Colors): void {
  const [x, y, w, h] = box;
  context.fillStyle = fill[state - 1] ?? fill[0]!;
  context.fillRect(x, y, w, h);
  [context.strokeStyle, context.fillStyle, context.lineWidth] = [paper, paper, Math.max(1, Math.min(w, h) / 8)];
  const at = (a: number, b: number): [number, number] => [x + a * w, y + b * h];
  context.beginPath();
  if (state === JobState.WAITING) {
    context.fillRect(x + w / 5, y + h / 5, (3 * w) / 5, (3 * h) / 5);
  } else if (state === JobState.COMPUTING) {
    context.arc(...at(0.5, 0.5), Math.min(w, h) / 5, 0, 2 * Math.PI);
    context.fill();
  } else if (state === JobState.CHECKED) {
    context.moveTo(...at(0.2, 0.5));
    context.lineTo(...at(0.42, 0.75));
    context.lineTo(...at(0.8, 0.25));
  } else if (state === JobState.FAILED) {
    context.moveTo(...at(0.2, 0.2));
    context.lineTo(...at(0.8, 0.8));
    context.moveTo(...at(0.8, 0.2));
    context.lineTo(...at(0.2, 0.8));
  }
  context.stroke();
}

type Sheet = { rows: number; columns: number; width: number; height: number; stateAt: (cell: Cell) => JobState };

// Cells with signs, with lines between them, or as pixels: as there is room. Width and height are those of a cell.
export function paintJobs(canvas: HTMLCanvasElement, { rows, columns, width, height, stateAt }: Sheet): void {
  const context = canvas.getContext('2d');
  if (!context || columns === 0 || rows === 0) return;
  const least = Math.min(width, height);
  const fine = least >= 4 ? window.devicePixelRatio || 1 : 1;
  const [w, h] = least >= 4 ? [width * fine, height * fine] : [1, 1];
  const gap = least >= 4 ? fine : 0;
  const colors = stateColors();
  canvas.width = Math.round(w * columns);
  canvas.height = Math.round(h * rows);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const state = stateAt({ row, column });
      const box: [number, number, number, number] = [column * w, row * h, w - gap, h - gap];
      if (least >= 7) {
        paintCell(context, state, box, colors);
      } else {
        context.fillStyle = colors.fill[state - 1] ?? colors.fill[0]!;
        context.fillRect(...box);
      }
    }
  }
}
