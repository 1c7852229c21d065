// The current measurement and its answer, shared by the tabs and kept over a reload of the page.
import type { Note, OpenCaptureResponse, SummarizeResponse } from '../gen/desk/v1/desk_pb';
import type { MeasureResponse } from '../gen/farm/v1/fits_pb';
import type { Measurement } from '../gen/farm/v1/model_pb';
import { desk, text } from './api';
import type { Options } from './known.svelte';
import { keep, kept, wasMeasured, type Dropped } from './kept';
import { route } from './route.svelte';

// An answer with the options of its request, which may have changed on the page since.
export type Answer = {
  found: MeasureResponse;
  summary: SummarizeResponse;
  colors: Map<string, [number, number, number]>;
  dictionary: string;
  options: Options;
  line: string;
};

class Measured {
  // Name of the file, or of the capture's folder.
  name = $state('');
  capture = $state.raw<OpenCaptureResponse | null>(null);
  // Whether it is the documentation's example.
  example = $state(false);
  materials = $state.raw<Measurement[]>([]);
  notes = $state.raw<Note[]>([]);
  answer = $state.raw<Answer | null>(null);
  // The current action, as shown to users.
  busy = $state('');
  wrong = $state('');
  // Whether it was measured before a reload, so that it is measured again.
  again = $state(false);
  // Answers for an older file are discarded.
  turn = 0;
  // The last requested capture, whether or not it could be opened.
  #asked: string | null = null;

  // The chosen file; null for the example of the documentation.
  choose(file: File | null): Promise<void> {
    this.#forget(null);
    return this.#read(async () => file && { name: file.name, content: await bytesOf(file) }, true);
  }

  chooseCapture(folder: string): Promise<void> {
    this.#forget(folder);
    return this.#open(folder, true);
  }

  // Follows the address: a capture in the link is opened, and an open one is added to the link.
  follow(folder: string | null): void {
    if (folder && folder !== this.#asked) void this.#open(folder, false);
    else if (!folder && this.capture) route.set({ capture: this.name });
  }

  // Restores the choice from before a reload.
  restore(): void {
    if (this.name || this.busy || route.get('capture')) return;
    const before = kept();
    if (before) void this.#read(() => Promise.resolve(before), false);
  }

  // Removes parameters of the link that belong to another measurement.
  #forget(capture: string | null): void {
    this.#asked = capture;
    this.capture = null;
    route.set({ capture, scale: null, lambda: null, sigma_t: null, albedo: null, g: null, look: null, map: null });
  }

  // Accepts the answer, unless there was another request meanwhile.
  async #load(ask: () => Promise<() => void>): Promise<void> {
    const own = (this.turn += 1);
    [this.again, this.busy, this.wrong] = [false, 'Reading…', ''];
    [this.answer, this.name, this.capture, this.materials, this.notes] = [null, '', null, [], []];
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

  #read(get: () => Promise<Dropped | null>, chosen: boolean): Promise<void> {
    return this.#load(async () => {
      const file = await get();
      const { materials, notes } = await desk.readMeasurements(file ? { file: { ...file, mediaType: 'text/csv' } } : {});
      return () => {
        [this.name, this.materials, this.notes, this.example] = [file?.name ?? 'white.csv', materials, notes, !file];
        if (chosen) keep(file);
        else this.again = wasMeasured(this.name);
      };
    });
  }

  #open(folder: string, chosen: boolean): Promise<void> {
    this.#asked = folder;
    return this.#load(async () => {
      const capture = await desk.openCapture({ folder });
      return () => {
        [this.name, this.materials, this.notes, this.capture] = [folder, capture.materials, capture.notes, capture];
        if (chosen) keep(null);
        else this.again = wasMeasured(folder);
      };
    });
  }
}

async function bytesOf(file: File): Promise<Uint8Array> {
  try {
    return new Uint8Array(await file.arrayBuffer());
  } catch {
    throw new Error(`${file.name} cannot be read as a file; if it is a capture's folder, choose it from the list`);
  }
}

export const measured = new Measured();
