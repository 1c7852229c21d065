// The farm's dictionaries, shared by the tabs.
import { DictionaryState, type Dictionary } from '../gen/farm/v1/dictionaries_pb';
import { PriorKind } from '../gen/farm/v1/model_pb';
import { dictionaries } from './api';

export const STATES: Record<DictionaryState, string> = {
  [DictionaryState.UNSPECIFIED]: '',
  [DictionaryState.RUNNING]: 'running',
  [DictionaryState.DONE]: 'done',
  [DictionaryState.FAILED]: 'some jobs failed',
  [DictionaryState.PAUSED]: 'paused',
  [DictionaryState.CANCELLED]: 'cancelled',
  [DictionaryState.OUTDATED]: 'of another physics version',
};

// All pages of the list; there are seldom more than one.
export async function listDictionaries(): Promise<Dictionary[]> {
  const all: Dictionary[] = [];
  let pageToken = '';
  do {
    const page = await dictionaries.list({ pageToken });
    all.push(...page.dictionaries);
    pageToken = page.nextPageToken;
  } while (pageToken !== '');
  return all;
}

// Whether a dictionary is for all boards: questions about it need the board of a session.
export function isForAllBoards(dictionary: Dictionary): boolean {
  return dictionary.grid?.scene?.channels[0]?.name === 'board 1';
}

// The documentation's example was rendered in the scene `paper`. Otherwise its dictionary is used only where it is named,
// since its surfaces lose light.
const EXAMPLE = 'paper';

// The dictionary that `farmctl` uses without --dictionary: `lab`, or the only one besides the paper's.
export function usual(all: Dictionary[]): Dictionary | undefined {
  const others = all.filter((d) => !isForAllBoards(d) && d.name !== EXAMPLE);
  return others.find((d) => d.name === 'lab') ?? (others.length === 1 ? others[0] : undefined);
}

export const NEW_FOR_EXAMPLE = `#/farm?scene=${EXAMPLE}`;

// The page's default: for the example a dictionary of its scene, if there is one.
export function preset(ready: Dictionary[], example: boolean): Dictionary | undefined {
  const rendered = example ? (ready.find((d) => d.name === EXAMPLE) ?? ready.find(losesLight)) : undefined;
  return rendered ?? usual(ready) ?? ready.find((d) => d.name !== EXAMPLE);
}

// Whether rough surfaces lose the light that they scatter more than once.
export function losesLight(dictionary: Dictionary | undefined): boolean {
  return dictionary?.grid?.scene?.multipleScattering === false;
}

// Whether fits estimate the weight of a second lobe of the phase function: the scene has one with a standard error.
export function hasUncertainLobe(dictionary: Dictionary | undefined): boolean {
  const grid = dictionary?.grid;
  return grid !== undefined && grid.responses.length > 0 && (grid.scene?.priors.some((p) => p.kind === PriorKind.SECOND_LOBE_WEIGHT) ?? false);
}
