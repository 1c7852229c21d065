// Asks this page's server the questions that `farmctl` answers: the inputs of a verb by the names of its options, and the
// answer as `--json` prints it, as far as the page uses it.
import { Failure, link } from './link.svelte';

export type Medium = { sigma_t_per_mm: number; albedo: number; g: number };
export type Interval = { low: number; high: number };
export type Note = { text: string };
export type Mixture = { material: string };
export type Quantity = { name: string; help: string; default: number; lowest: number; highest: number };
export type Measurement = { material: string; profiles: { channel: string; thickness_mm: number }[] };
export type Checked = { materials: Measurement[]; notes: Note[] };
export type About = { farm: string; own: boolean; command: string; quantities: Quantity[] };
export type Board = { name: string; rho_light: number; rho_dark: number }[];

export type Capture = { folder: string; report: string };
export type OpenCapture = {
  measurement: Checked;
  set_up: Record<string, number>;
  // Null without a white reference of known error.
  mu_std_error: number | null;
  dictionary: string;
  records: number;
  // Empty unless the dictionary is for all boards.
  board: Board;
};
export type CaptureProgress = {
  session: string;
  step: string;
  share: number;
  is_running: boolean;
  folder: string;
  warnings: string[];
  error: string;
};

export type Curve = { values: number[]; gradient: number[] };
export type FitCurves = { thickness_mm: number; x_mm: number[]; measured: Curve; candidates: Curve[]; refined: Curve | null; residuals: number[] };
export type Refined = Medium & {
  resolved: boolean;
  resolved_at_g: boolean;
  sigma_t_interval: Interval;
  albedo_interval: Interval;
  likelihood: { nuisances: { nuisance: string }[] };
};
export type ChannelFit = { channel: string; candidates: Medium[]; refined: Refined | null; curves?: FitCurves[] };
export type MaterialFit = { material: string; channels: ChannelFit[] };
export type MapLayer = { g: number; errors: number[][]; best: Medium & { error: number }; similar: Omit<Medium, 'g'> | null };
export type DistanceMap = { channel: string; sigma_t_per_mm: number[]; albedo: number[]; best_layer: number; layers: MapLayer[] };

// Texts that are those of the terminal.
export type Shown = { value: string; interval: string };
export type Numbers = Record<'reduced_scattering_per_mm' | 'absorption_per_mm' | 'sigma_t_per_mm' | 'albedo' | 'g', Shown> & { misfit: string };
export type Remark = { about: string[]; text: string; warning: boolean };
export type AnswerInWords = {
  common: string;
  // By material and channel.
  numbers: (Numbers | null)[][];
  objective: string[];
  remarks: Remark[];
  estimates: { quantity: string; of: string; estimate: string; prior: string; warning: string | null }[];
  estimates_note: string;
  budget: { channels: { about: string; sigma_t: string; shares: string }[]; first: string } | null;
  verdict: { sentences: string[]; precision: { material: string; half_widths: string[] }[] };
};

// A measurement that is kept with the farm.
export type KeptSummary = { id: string; title: string; note: string; source: string; command: string };

type Bounds = { min: number | null; max: number | null };
export type Measured = {
  dictionary: string;
  mu: number;
  g_range: Bounds;
  sigma_t_range: Bounds;
  albedo_range: Bounds;
  wavelet: string;
  level: number;
  objective: string | null;
  phase: string;
  common: { mu: number };
  materials: MaterialFit[];
  not_kept?: string;
  page: {
    shown: AnswerInWords;
    // The contents of media.json; null without intervals.
    media: object | null;
    colours: Record<string, [number, number, number]>;
    measurement: Checked;
    board: Board;
    kept: KeptSummary | null;
    searches_mu: boolean;
    free_g: boolean;
    not_written: string | null;
  };
};

export type Predicted = {
  channels: { channel: string; bases: { base: string; radiance_factor: number; std_error: number; interval: [number, number] }[] }[];
  colours: {
    bases: { lab: [number, number, number]; lab_std_errors: [number, number, number]; srgb: [number, number, number] | null }[];
    contrast_ratio: [number, number] | null;
    delta_e_2000: [number, number] | null;
  } | null;
  no_colours?: string;
  unresolved: string[];
};
export type Compared = {
  channels: { material: string; channel: string; quantities: { quantity: string; a: number; b: number; e_n: number | null; pooled: [number, number] | null }[] }[];
  unmatched: string[];
  conclusion: string;
  titles: [string, string];
};
export type Simulated = { walks: number; channels: { channel: string; values: number[]; std_errors: number[] }[] };
export type GridSize = { records: number; jobs: number; bytes: number };
export type SavedFile = { name: string; base64: string };

type Answers = {
  about: About;
  captures: Capture[];
  sessions: string[];
  capture: null;
  progress: CaptureProgress;
  check: Checked;
  open: OpenCapture;
  mixtures: Mixture[];
  measure: Measured;
  map: { maps: DistanceMap[] };
  files: SavedFile;
  figures: SavedFile;
  predict: Predicted;
  compare: Compared;
  grid: GridSize;
  submit: object;
  simulate: Simulated;
};

// Relative to the page, at any path prefix of a proxy.
export async function ask<V extends keyof Answers>(verb: V, inputs: object = {}, signal?: AbortSignal): Promise<Answers[V]> {
  const request: RequestInit = { method: 'POST', body: JSON.stringify(inputs) };
  const response = await fetch(`ask/${verb}`, signal ? { ...request, signal } : request).catch((error: unknown) => {
    if (!signal?.aborted) link.lost('page', SILENT);
    throw error;
  });
  if (response.status === 401) {
    link.lost('page', ENTRANCE);
    throw new Failure(ENTRANCE);
  }
  const answer = (await response.json()) as { data: Answers[V]; error?: string };
  if (response.status === 503) link.lost('farm', answer.error ?? '');
  else link.reached('page');
  if (answer.error !== undefined) throw new Failure(answer.error);
  return answer.data;
}

export const ENTRANCE = 'open the address that farmctl web has printed';
export const SILENT = 'the server of this page does not answer';
