// Words and ranges of a question, which are those of `farmctl measure`, in the parameters of a link.
import type { Measured, Quantity } from './ask';

// Phase functions by the words of `farmctl --phase` and those of its answers; the default is left out.
export const PHASES: Record<string, string> = { 'per-channel': 'per_channel', hg: 'henyey_greenstein' };

// Parameters of the bounds of a medium, with the names of the options.
export const BOUNDS = [
  { parameter: 'within_sigma_t', option: 'sigma_t', label: 'σ_t [1/mm]', example: '4..8' },
  { parameter: 'within_albedo', option: 'albedo', label: 'α', example: '0.9..' },
] as const;

// Whether a text is a range such as 0.4, 0.2..0.6, 4.. or ..8.
export function isRange(text: string | null): text is string {
  if (!text) return false;
  const ends = text.split('..').map((end) => end.trim());
  return ends.length <= 2 && ends.some((end) => end !== '') && ends.every((end) => Number.isFinite(Number(end)));
}

function textOf({ min, max }: Measured['g_range']): string | null {
  if (min === null && max === null) return null;
  return min === max ? String(min) : `${min ?? ''}..${max ?? ''}`;
}

// The option of `farmctl` for an input.
export function optionOf(name: string): string {
  return `--${name.replaceAll('_', '-')}`;
}

// The parameters of a link with which the page asks the question of an answer.
export function parametersOf(
  answer: Measured,
  quantities: readonly Quantity[],
  session: Record<string, number> | undefined,
): Record<string, string | number | null> {
  const parameters: Record<string, string | number | null> = {
    dictionary: answer.dictionary,
    mu: answer.page.searches_mu ? null : answer.mu,
    held: answer.page.free_g ? 'free' : textOf(answer.g_range),
    objective: answer.objective === 'paper' ? 'paper' : null,
    phase: Object.keys(PHASES).find((word) => PHASES[word] === answer.phase) ?? null,
    within_sigma_t: textOf(answer.sigma_t_range),
    within_albedo: textOf(answer.albedo_range),
  };
  const used = answer as unknown as Record<string, number>;
  for (const { name, default: usual } of quantities) {
    parameters[name] = used[name] === (session?.[name] ?? usual) ? null : (used[name] ?? null);
  }
  return parameters;
}
