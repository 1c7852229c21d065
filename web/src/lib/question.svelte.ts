// The question of the current measurement: its dictionary and options, from the link, with the equivalent command.
import { DictionaryState, type Dictionary } from '../gen/farm/v1/dictionaries_pb';
import type { SetUpQuantity } from '../gen/desk/v1/desk_pb';
import { Objective, PhaseModel, type Mixture } from '../gen/farm/v1/fits_pb';
import { desk } from './api';
import { hasUncertainLobe, isForAllBoards, listDictionaries, preset, usual } from './known.svelte';
import { measured } from './measured.svelte';
import { quoted } from './numbers';
import { BOUNDS, fieldOf, optionOf, PHASES, rangeOf, standardOf, type MeasureQuestion, type Options } from './request';
import { route } from './route.svelte';

class Question {
  all = $state.raw<Dictionary[] | null>(null);
  quantities = $state.raw<SetUpQuantity[]>([]);
  // The file of mixtures, with its contents.
  mixtures = $state.raw<{ name: string; list: Mixture[] } | null>(null);

  readonly #done = $derived(this.all?.filter((d) => d.state === DictionaryState.DONE) ?? []);
  // Dictionaries with boards of their own.
  readonly ready = $derived(this.#done.filter((d) => !isForAllBoards(d)));
  readonly dictionary = $derived.by(() => {
    const named = (name: string | null): Dictionary | undefined => this.#done.find((d) => d.name === name && (!isForAllBoards(d) || measured.board.length > 0));
    return measured.capture ? named(measured.capture.dictionary) : (named(route.get('dictionary')) ?? preset(this.ready, measured.example));
  });
  // Links may come from anywhere, so only numbers and allowed words are accepted.
  readonly scaleFactor = $derived(measured.capture?.muKnown ? 'known' : String(route.number('mu') ?? 'search'));
  readonly anisotropy = $derived(route.get('held') === 'free' ? 'free' : rangeOf(route.get('held')) ? route.get('held')! : 'common');
  readonly objective = $derived(route.get('objective') === 'paper' ? 'paper' : 'likelihood');
  // Only the likelihood estimates the second lobe.
  readonly choosesPhase = $derived(this.objective === 'likelihood' && hasUncertainLobe(this.dictionary));
  readonly phase = $derived(this.choosesPhase ? (Object.keys(PHASES).find((word) => word === route.get('phase')) ?? 'two-lobes') : 'two-lobes');

  async load(): Promise<void> {
    this.quantities = (await desk.listSetUpQuantities({})).quantities;
  }

  async refresh(): Promise<void> {
    this.all = await listDictionaries();
  }

  standard(quantity: SetUpQuantity): number {
    return standardOf(quantity, measured.capture?.options);
  }

  // The value of a quantity in the link, if it is in the allowed range.
  given(quantity: SetUpQuantity): number | null {
    const value = route.number(quantity.name);
    return value !== null && value >= quantity.lowest && value <= quantity.highest ? value : null;
  }

  options(): Options {
    const { $typeName: _t, $unknown: _u, ...known } = measured.capture?.options ?? {};
    const g = this.anisotropy === 'common' || this.anisotropy === 'free' ? null : rangeOf(this.anisotropy);
    const bounds = BOUNDS.map(({ parameter, field }) => [field, rangeOf(route.get(parameter))] as const);
    const given = this.quantities.map((q) => [fieldOf(q), this.given(q)] as const);
    return {
      ...known,
      ...Object.fromEntries([...bounds, ...given].filter(([, value]) => value !== null)),
      refine: true,
      curves: true,
      ...(Number.isFinite(Number(this.scaleFactor)) ? { mu: Number(this.scaleFactor) } : {}),
      ...(g ? { g } : {}),
      ...(this.objective === 'paper' ? { objective: Objective.PAPER } : {}),
      phase: PHASES[this.phase] ?? PhaseModel.UNSPECIFIED,
    };
  }

  request(dictionary: Dictionary): MeasureQuestion {
    return {
      dictionary: dictionary.name,
      board: isForAllBoards(dictionary) ? measured.board : [],
      materials: measured.materials,
      options: this.options(),
      commonG: this.anisotropy !== 'free',
      mixtures: this.mixtures?.list ?? [],
      ...(this.scaleFactor === 'search' ? { searchMu: {} } : {}),
    };
  }

  // The command that measures the same.
  line(command: string): string {
    const { dictionary, anisotropy } = this;
    const mu = Number(this.scaleFactor);
    return [
      `${command} measure ${quoted(measured.name || 'white.csv')}`,
      !measured.capture && dictionary && dictionary.name !== usual(this.all ?? [])?.name ? `--dictionary ${quoted(dictionary.name)}` : '',
      Number.isFinite(mu) ? `--mu ${mu}` : '',
      anisotropy === 'common' ? '' : anisotropy === 'free' ? '--free-g' : `--g ${anisotropy}`,
      ...BOUNDS.map(({ parameter, option }) => (rangeOf(route.get(parameter)) ? `${option} ${route.get(parameter)}` : '')),
      this.objective === 'paper' ? '--objective paper' : '',
      this.phase === 'two-lobes' ? '' : `--phase ${this.phase}`,
      this.mixtures ? `--mixtures ${quoted(this.mixtures.name)}` : '',
      ...this.quantities.map((q) => (this.given(q) === null ? '' : `${optionOf(q)} ${this.given(q)}`)),
      measured.capture ? '' : '--output media',
    ]
      .filter(Boolean)
      .join(' ');
  }
}

export const question = new Question();
