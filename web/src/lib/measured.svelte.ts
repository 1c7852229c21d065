// The current measurement and its answer, shared by the tabs. An answer that is kept with the farm has its id in the link;
// a file is kept over a reload of the page.
import { text } from './api';
import { ask, type Board, type KeptSummary, type Measured as Found, type Measurement, type Note, type OpenCapture } from './ask';
import { dropped, keep } from './dropped';
import { given, type GivenFile } from './files';
import { parametersOf } from './request';
import { route } from './route.svelte';

// An answer with its question, which may have changed on the page since.
export type Answer = {
  found: Found;
  // Inputs with which `measure` gives this answer.
  inputs: object;
  line: string;
  // Null if it is not kept.
  kept: KeptSummary | null;
};

// Parameters of the link that belong to one measurement.
const OWN = { scale: null, lambda: null, sigma_t: null, albedo: null, g: null, look: null, map: null };

class Measured {
  // Name of the file, or of the capture's folder.
  name = $state('');
  capture = $state.raw<OpenCapture | null>(null);
  // Inputs that name the measurement: a file, the folder of a capture, or one that is kept; empty for the example.
  source = $state.raw<object>({});
  // The board of the capture, for dictionaries for all boards.
  board = $state.raw<Board>([]);
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
    return this.#read(async () => file && given(file));
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

  // Measures, and keeps the answer with the farm if wanted; it then goes into the capture's folder, too.
  async ask(inputs: object, line: string, isKept: boolean): Promise<void> {
    this.#asking?.abort();
    const [own, asking] = [this.turn, new AbortController()];
    [this.busy, this.wrong, this.#asking] = ['Measuring…', '', asking];
    try {
      const keep = isKept ? { keep: { source: this.name, command: line, title: titleOf(this.materials, line) } } : {};
      const found = await ask('measure', { ...inputs, ...keep }, asking.signal);
      if (own !== this.turn || asking.signal.aborted) return;
      const { kept, not_written } = found.page;
      this.answer = { found, inputs, line, kept };
      this.#asked.kept = kept?.id ?? null;
      route.set({ kept: kept?.id ?? null });
      if (found.not_kept) this.wrong = `The measurement is not kept: ${found.not_kept}`;
      if (not_written) this.wrong = `The folder has no media of this answer: ${not_written}`;
    } catch (error) {
      if (own !== this.turn || asking.signal.aborted) return;
      this.wrong = text(error);
    }
    this.busy = '';
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

  #read(get: () => Promise<GivenFile | null>): Promise<void> {
    return this.#load(async () => {
      const file = await get();
      const source = file ? { file } : {};
      const { materials, notes } = await ask('check', source);
      return () => {
        [this.name, this.source, this.materials, this.notes, this.example] = [file?.name ?? 'white.csv', source, materials, notes, !file];
        keep(file);
      };
    });
  }

  #open(folder: string): Promise<void> {
    this.#asked.capture = folder;
    return this.#load(async () => {
      const capture = await ask('open', { capture: folder });
      return () => {
        this.#take(folder, capture);
        keep(null);
      };
    });
  }

  #take(folder: string, capture: OpenCapture): void {
    [this.name, this.source, this.capture] = [folder, { capture: folder }, capture];
    [this.materials, this.notes, this.board] = [capture.measurement.materials, capture.measurement.notes, capture.board];
  }

  #openKept(id: string): Promise<void> {
    this.#asked.kept = id;
    return this.#load(async () => {
      const found = await ask('measure', { kept: id });
      const { kept, measurement, board } = found.page;
      if (!kept) throw new Error(`measurement ${id} is not whole`);
      const { source, title, command } = kept;
      const [captures, { quantities }] = await Promise.all([ask('captures'), ask('about')]);
      const capture = captures.some((c) => c.folder === source) ? await ask('open', { capture: source }) : null;
      return () => {
        if (capture) this.#take(source, capture);
        else [this.name, this.source, this.materials, this.board] = [source || title, { data_of: id }, measurement.materials, board];
        this.answer = { found, inputs: { kept: id }, line: command, kept };
        this.#asked.capture = capture ? source : null;
        route.set({ ...parametersOf(found, quantities, capture?.set_up), ...(capture ? { mu: null, dictionary: null, capture: source } : {}) });
        keep(null);
      };
    });
  }
}

// The materials, with the options that are not the defaults; empty without such options, so that an earlier title stays.
function titleOf(materials: Measurement[], line: string): string {
  const options = line.split(' --').slice(1).filter((option) => !option.startsWith('output ') && !option.startsWith('data '));
  if (options.length === 0) return '';
  return `${materials.map((m) => m.material).join(', ')} (${options.join(', ')})`.slice(0, 190);
}

export const measured = new Measured();
