// The current measurement and its answer, shared by the tabs. An answer that is kept with the farm has its id in the link;
// a file is kept over a reload of the page.
import type { Note, OpenCaptureResponse, SummarizeResponse } from '../gen/desk/v1/desk_pb';
import { Objective, type MaterialFit, type MeasureResponse } from '../gen/farm/v1/fits_pb';
import type { KeptMeasurement, MeasurementSummary } from '../gen/farm/v1/measurements_pb';
import type { Channel, Grid, Measurement, Medium } from '../gen/farm/v1/model_pb';
import { desk, fits, kept, text } from './api';
import { dropped, keep, type Dropped } from './dropped';
import { gridOver } from './known.svelte';
import { parametersOf, type MeasureQuestion, type Options } from './request';
import { route } from './route.svelte';

// An answer with the question's options, which may have changed on the page since.
export type Answer = {
  found: MeasureResponse;
  summary: SummarizeResponse;
  colors: Map<string, [number, number, number]>;
  dictionary: string;
  // As in the question.
  board: Channel[];
  grid: Grid | undefined;
  options: Options;
  line: string;
  // Null if it is not kept.
  kept: MeasurementSummary | null;
};

// Parameters of the link that belong to one measurement.
const OWN = { scale: null, lambda: null, sigma_t: null, albedo: null, g: null, look: null, map: null };

class Measured {
  // Name of the file, or of the capture's folder.
  name = $state('');
  capture = $state.raw<OpenCaptureResponse | null>(null);
  // The board of the capture, for dictionaries for all boards.
  board = $state.raw<Channel[]>([]);
  // Whether it is the documentation's example.
  example = $state(false);
  materials = $state.raw<Measurement[]>([]);
  notes = $state.raw<Note[]>([]);
  answer = $state.raw<Answer | null>(null);
  // The current action, as shown to users.
  busy = $state('');
  wrong = $state('');
  // Answers for an older file are discarded.
  turn = 0;
  // A question ends the one before.
  #asking: AbortController | null = null;
  // The last requested capture and kept measurement, whether or not they could be opened.
  #asked: { capture: string | null; kept: string | null } = { capture: null, kept: null };

  // The chosen file; null for the example of the documentation.
  choose(file: File | null): Promise<void> {
    this.#forget({ capture: null, kept: null });
    return this.#read(async () => file && { name: file.name, content: await bytesOf(file) });
  }

  chooseCapture(folder: string): Promise<void> {
    this.#forget({ capture: folder, kept: null });
    return this.#open(folder);
  }

  // Follows the address: what its link names is opened, and what is open is added to it.
  follow(folder: string | null, id: string | null): void {
    if (id && id !== this.#asked.kept) void this.#openKept(id);
    else if (id) return;
    else if (folder && folder !== this.#asked.capture) void this.#open(folder);
    else if (!folder && this.capture) route.set({ capture: this.name });
    else if (this.answer?.kept) route.set({ kept: this.answer.kept.id });
  }

  // Restores the file from before a reload.
  restore(): void {
    if (this.name || this.busy || route.get('capture') || route.get('kept')) return;
    const before = dropped();
    if (before) void this.#read(() => Promise.resolve(before));
  }

  // Back to the first screen.
  close(): void {
    this.#forget({ capture: null, kept: null });
    keep(null);
    this.turn += 1;
    [this.answer, this.name, this.materials, this.notes, this.busy, this.wrong] = [null, '', [], [], '', ''];
    this.example = false;
  }

  // Measures, and keeps the answer with the farm if wanted.
  async ask(request: MeasureQuestion, line: string, grid: Grid | undefined, isKept: boolean): Promise<void> {
    this.#asking?.abort();
    const [own, asking, board] = [this.turn, new AbortController(), request.board];
    [this.busy, this.wrong, this.#asking] = ['Measuring…', '', asking];
    try {
      const keep = isKept ? { keep: { source: this.name, command: line, title: titleOf(request, line), note: '' } } : {};
      const found = await fits.measure({ ...request, ...keep }, { signal: asking.signal });
      const [answer, summary] = await Promise.all([
        this.#answer(found, request.options, { dictionary: request.dictionary, board, grid: gridOver(grid, board), line }),
        found.keptId ? kept.get({ id: found.keptId }).then((k) => k.summary ?? null) : null,
      ]);
      if (own !== this.turn || asking.signal.aborted) return;
      this.answer = { ...answer, kept: summary };
      this.#asked.kept = summary?.id ?? null;
      route.set({ kept: summary?.id ?? null });
      this.wrong = found.notKept && `The measurement is not kept: ${found.notKept}`;
      if (this.capture && isKept) await this.#complete(this.answer).catch((error: unknown) => (this.wrong = `The folder has no media of this answer: ${text(error)}`));
    } catch (error) {
      if (own !== this.turn || asking.signal.aborted) return;
      this.wrong = text(error);
    }
    this.busy = '';
  }

  // Writes media and report into the capture's folder, as the command does; the paper's distance gives no media.
  async #complete({ found, dictionary, grid, options }: Answer): Promise<void> {
    if (!grid || options.objective === Objective.PAPER) return;
    const media = { found, dictionary, grid, capture: this.name };
    await desk.completeCapture({ media, materials: this.materials, options });
  }

  async #answer(found: MeasureResponse, options: Options, asked: Pick<Answer, 'dictionary' | 'board' | 'grid' | 'line'>): Promise<Omit<Answer, 'kept'>> {
    const mu = found.common?.mu ?? found.mu;
    const muStdError = Math.min(1, found.common?.muStdError ?? found.muStdError);
    const folder = this.capture ? { capture: this.name } : {};
    const [summary, colors] = await Promise.all([
      desk.summarize({ found, materials: this.materials, options: { ...options, mu, muStdError }, ...folder }),
      colorsOf(found.materials),
    ]);
    return { found, summary, colors, options, ...asked };
  }

  #forget(asked: { capture: string | null; kept: string | null }): void {
    this.#asked = asked;
    this.capture = null;
    route.set({ ...asked, ...OWN });
  }

  // Accepts the answer, unless there was another request meanwhile.
  async #load(ask: () => Promise<() => void>): Promise<void> {
    const own = (this.turn += 1);
    [this.busy, this.wrong] = ['Reading…', ''];
    [this.answer, this.name, this.capture, this.board, this.materials, this.notes] = [null, '', null, [], [], []];
    this.example = false;
    try {
      const take = await ask();
      if (own !== this.turn) return;
      take();
    } catch (error) {
      if (own !== this.turn) return;
      this.wrong = text(error);
    }
    this.busy = '';
  }

  #read(get: () => Promise<Dropped | null>): Promise<void> {
    return this.#load(async () => {
      const file = await get();
      const { materials, notes } = await desk.readMeasurements(file ? { file: { ...file, mediaType: 'text/csv' } } : {});
      return () => {
        [this.name, this.materials, this.notes, this.example] = [file?.name ?? 'white.csv', materials, notes, !file];
        keep(file);
      };
    });
  }

  #open(folder: string): Promise<void> {
    this.#asked.capture = folder;
    return this.#load(async () => {
      const capture = await desk.openCapture({ folder });
      return () => {
        [this.name, this.materials, this.notes, this.capture, this.board] = [folder, capture.materials, capture.notes, capture, capture.board];
        keep(null);
      };
    });
  }

  #openKept(id: string): Promise<void> {
    this.#asked.kept = id;
    return this.#load(async () => {
      const one = await kept.get({ id });
      const capture = await captureOf(one);
      const { quantities } = await desk.listSetUpQuantities({});
      const { request, answer: found, summary, grid } = one;
      if (!request || !found || !summary) throw new Error(`measurement ${id} is not whole`);
      [this.materials, this.capture, this.board, this.name] = [request.materials, capture, request.board, summary.source || summary.title];
      const { $typeName: _t, $unknown: _u, ...options } = request.options ?? {};
      const answer = await this.#answer(found, options, { dictionary: request.dictionary, board: request.board, grid, line: summary.command });
      return () => {
        this.answer = { ...answer, kept: summary };
        this.#asked.capture = capture ? summary.source : null;
        route.set({ ...parametersOf(request, quantities, capture?.options), ...(capture ? { mu: null, dictionary: null, capture: summary.source } : {}) });
        keep(null);
      };
    });
  }
}

// The capture's folder of a kept measurement, if this page has it.
async function captureOf(one: KeptMeasurement): Promise<OpenCaptureResponse | null> {
  const source = one.summary?.source ?? '';
  const { captures } = await desk.listCaptures({});
  return captures.some((c) => c.folder === source) ? desk.openCapture({ folder: source }) : null;
}

// The materials, with the options that are not the defaults; empty without such options, so that an earlier title stays.
function titleOf(request: MeasureQuestion, line: string): string {
  const options = line.split(' --').slice(1).filter((option) => !option.startsWith('output ') && !option.startsWith('data '));
  if (options.length === 0) return '';
  return `${request.materials.map((m) => m.material).join(', ')} (${options.join(', ')})`.slice(0, 190);
}

// Colours of materials with R, G and B.
async function colorsOf(materials: MaterialFit[]): Promise<Map<string, [number, number, number]>> {
  const colors = new Map<string, [number, number, number]>();
  const media = materials.map((m) => ({
    name: m.material,
    rgb: ['R', 'G', 'B']
      .map((c) => m.channels.find((f) => f.channel === c)?.refined?.best?.medium)
      .filter((medium): medium is Medium => medium !== undefined),
  }));
  const whole = media.filter((m) => m.rgb.length === 3).slice(0, 80);
  if (whole.length === 0) return colors;
  const { radianceFactors: v } = await desk.colors({ media: whole.flatMap((m) => m.rgb) });
  whole.forEach((m, i) => colors.set(m.name, [v[3 * i] ?? 0, v[3 * i + 1] ?? 0, v[3 * i + 2] ?? 0]));
  return colors;
}

async function bytesOf(file: File): Promise<Uint8Array> {
  try {
    return new Uint8Array(await file.arrayBuffer());
  } catch {
    throw new Error(`${file.name} cannot be read as a file; if it is a capture's folder, choose it from the list`);
  }
}

export const measured = new Measured();
