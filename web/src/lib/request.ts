// Converts between the question of a measurement and the parameters of a link: words and ranges are those of `farmctl`.
import type { MessageInitShape } from '@bufbuild/protobuf';
import type { SetUpQuantity } from '../gen/desk/v1/desk_pb';
import { Objective, PhaseModel, type Bounds, type FitOptions, type FitOptionsSchema, type MeasureRequest, type Mixture } from '../gen/farm/v1/fits_pb';
import type { Channel, Measurement } from '../gen/farm/v1/model_pb';

export type Options = Exclude<MessageInitShape<typeof FitOptionsSchema>, { $unknown?: unknown }>;
// The question of a measurement; the scale factor is searched for with `searchMu`.
export type MeasureQuestion = {
  dictionary: string;
  // Empty, unless the dictionary is for all boards.
  board: Channel[];
  materials: Measurement[];
  options: Options;
  commonG: boolean;
  mixtures: Mixture[];
  searchMu?: Record<string, never>;
};
export type Range = { min?: number; max?: number };

// Phase functions by the words of `farmctl --phase`, the default left out.
export const PHASES: Record<string, PhaseModel> = {
  'per-channel': PhaseModel.PER_CHANNEL,
  hg: PhaseModel.HENYEY_GREENSTEIN,
};

// Parameters of the bounds, with the option of `farmctl` and the field of the request.
export const BOUNDS = [
  { parameter: 'within_sigma_t', option: '--sigma-t', field: 'sigmaTPerMm', label: 'σ_t [1/mm]', example: '4..8' },
  { parameter: 'within_albedo', option: '--albedo', field: 'albedo', label: 'α', example: '0.9..' },
] as const;

// A range such as 0.4, 0.2..0.6, 4.. or ..8; null if the text is none.
export function rangeOf(text: string | null): Range | null {
  if (!text) return null;
  const [low = '', high = low] = text.split('..');
  const number = (part: string): number | undefined => (part.trim() === '' ? undefined : Number(part));
  const [min, max] = [number(low), number(high)];
  if ([min, max].some((value) => value !== undefined && !Number.isFinite(value))) return null;
  if (min === undefined && max === undefined) return null;
  return { ...(min === undefined ? {} : { min }), ...(max === undefined ? {} : { max }) };
}

function textOf(bounds: Bounds | undefined): string | null {
  if (!bounds || (bounds.min === undefined && bounds.max === undefined)) return null;
  if (bounds.min === bounds.max) return String(bounds.min);
  return `${bounds.min ?? ''}..${bounds.max ?? ''}`;
}

// The field of FitOptions of a quantity of the set-up.
export function fieldOf(quantity: SetUpQuantity): keyof Options {
  return quantity.name.replaceAll(/_(\w)/g, (_, letter: string) => letter.toUpperCase()) as keyof Options;
}

export function optionOf(quantity: SetUpQuantity): string {
  return `--${quantity.name.replaceAll('_', '-')}`;
}

// The value of a quantity where the link has none: the session's, or the default.
export function standardOf(quantity: SetUpQuantity, session: FitOptions | undefined): number {
  const value = session?.[fieldOf(quantity) as 'gainStdError'];
  return typeof value === 'number' ? value : quantity.default;
}

// The parameters of a link with which the page asks the same question.
export function parametersOf(
  request: MeasureRequest,
  quantities: readonly SetUpQuantity[],
  session: FitOptions | undefined,
): Record<string, string | number | null> {
  const { options, searchMu, commonG, dictionary } = request;
  const parameters: Record<string, string | number | null> = {
    dictionary,
    mu: searchMu ? null : (options?.mu ?? 1),
    held: commonG ? textOf(options?.g) : 'free',
    objective: options?.objective === Objective.PAPER ? 'paper' : null,
    phase: Object.entries(PHASES).find(([, phase]) => phase === options?.phase)?.[0] ?? null,
  };
  for (const { parameter, field } of BOUNDS) parameters[parameter] = textOf(options?.[field]);
  for (const quantity of quantities) {
    const value = standardOf(quantity, options);
    parameters[quantity.name] = value === standardOf(quantity, session) ? null : value;
  }
  return parameters;
}
