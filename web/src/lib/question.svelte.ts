// The question of the current measurement: its dictionary and options, from the link, with the equivalent command.
import { DictionaryState, type Dictionary } from '../gen/farm/v1/dictionaries_pb';
import { ask, type Mixture, type Quantity } from './ask';
import type { GivenFile } from './files';
import { hasUncertainLobe, isForAllBoards, listDictionaries, preset, usual } from './known.svelte';
import { measured } from './measured.svelte';
import { quoted } from './numbers';
import { BOUNDS, isRange, optionOf, PHASES } from './request';
import { route } from './route.svelte';

class Question {
  all = $state.raw<Dictionary[] | null>(null);
  quantities = $state.raw<Quantity[]>([]);
  // The file of mixtures, with its contents.
  mixtures = $state.raw<{ file: GivenFile; list: Mixture[] } | null>(null);

  readonly #done = $derived(this.all?.filter((d) => d.state === DictionaryState.DONE) ?? []);
  // Dictionaries with boards of their own.
  readonly ready = $derived(this.#done.filter((d) => !isForAllBoards(d)));
  readonly dictionary = $derived.by(() => {
    const named = (name: string | null): Dictionary | undefined => this.#done.find((d) => d.name === name && (!isForAllBoards(d) || measured.board.length > 0));
    return measured.capture ? named(measured.capture.dictionary) : (named(route.get('dictionary')) ?? preset(this.ready, measured.example));
  });
  // Links may come from anywhere, so only numbers and allowed words are accepted.
  readonly scaleFactor = $derived(measured.capture?.mu_std_error != null ? 'known' : String(route.number('mu') ?? 'search'));
  readonly anisotropy = $derived(route.get('held') === 'free' ? 'free' : isRange(route.get('held')) ? route.get('held')! : 'common');
  readonly objective = $derived(route.get('objective') === 'paper' ? 'paper' : 'likelihood');
  // Only the likelihood estimates the second lobe.
  readonly choosesPhase = $derived(this.objective === 'likelihood' && hasUncertainLobe(this.dictionary));
  readonly phase = $derived(this.choosesPhase ? (Object.keys(PHASES).find((word) => word === route.get('phase')) ?? 'two-lobes') : 'two-lobes');

  // The options by the names that the command has for them, as far as they are not the defaults.
  readonly options = $derived.by((): Record<string, string | number | boolean> => {
    const mu = Number(this.scaleFactor);
    const { anisotropy, objective, phase } = this;
    const bounds = BOUNDS.map(({ parameter, option }) => [option, route.get(parameter)] as const);
    const given = this.quantities.map((q) => [q.name, this.given(q)] as const);
    return {
      ...(Number.isFinite(mu) ? { mu } : {}),
      ...(anisotropy === 'common' ? {} : anisotropy === 'free' ? { free_g: true } : { g: anisotropy }),
      ...Object.fromEntries(bounds.filter(([, range]) => isRange(range))),
      ...(objective === 'paper' ? { objective } : {}),
      ...(phase === 'two-lobes' ? {} : { phase }),
      ...Object.fromEntries(given.filter(([, value]) => value !== null)),
    };
  });

  async load(): Promise<void> {
    this.quantities = (await ask('about')).quantities;
  }

  async refresh(): Promise<void> {
    this.all = await listDictionaries();
  }

  // The value of a quantity where the link has none: the session's, or the default.
  standard({ name, default: usual }: Quantity): number {
    return measured.capture?.set_up[name] ?? usual;
  }

  // The value of a quantity in the link, if it is in the allowed range.
  given(quantity: Quantity): number | null {
    const value = route.number(quantity.name);
    return value !== null && value >= quantity.lowest && value <= quantity.highest ? value : null;
  }

  // The inputs of `measure`.
  inputs(dictionary: Dictionary): object {
    const mixtures = this.mixtures ? { mixtures: this.mixtures.file } : {};
    return { ...measured.source, dictionary: dictionary.name, ...mixtures, ...this.options };
  }

  // The command that measures the same.
  line(command: string): string {
    const { dictionary } = this;
    return [
      `${command} measure ${quoted(measured.name || 'white.csv')}`,
      !measured.capture && dictionary && dictionary.name !== usual(this.all ?? [])?.name ? `--dictionary ${quoted(dictionary.name)}` : '',
      ...Object.entries(this.options).map(([name, value]) => (value === true ? optionOf(name) : `${optionOf(name)} ${value}`)),
      this.mixtures ? `--mixtures ${quoted(this.mixtures.file.name)}` : '',
      measured.capture ? '' : '--output media',
    ]
      .filter(Boolean)
      .join(' ');
  }
}

export const question = new Question();
