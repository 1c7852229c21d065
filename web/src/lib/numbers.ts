// Numbers for axes, sliders and tooltips. Those of answers come as text from the server, with their significant digits.
export function significant(value: number, digits = 3): string {
  if (!Number.isFinite(value)) return '–';
  if (value === 0) return '0';
  const decimals = Math.min(12, Math.max(0, digits - 1 - Math.floor(Math.log10(Math.abs(value)))));
  const text = value.toFixed(decimals);
  return (text.includes('.') ? text.replace(/\.?0+$/, '') : text).replace('-', '−');
}

// Decimals that resolve steps of this size to a tenth.
export function decimalsOf(step: number): number {
  return step > 0 && Number.isFinite(step) ? Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(step)))) : 0;
}

// A number of a column, with the decimals of the column.
export function fixed(value: number, decimals: number): string {
  if (!Number.isFinite(value)) return '–';
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace('-', '') : text.replace('-', '−');
}

// A number with its standard error, which has one digit.
export function withError(value: number, stdError: number): string {
  const decimals = Math.max(0, decimalsOf(stdError) - 1);
  return `${fixed(value, decimals)} ± ${fixed(stdError, decimals)}`;
}

// An albedo with the digits that 1 − α needs.
export function albedo(value: number): string {
  const co = 1 - value;
  if (co <= 0) return '1';
  const decimals = Math.min(9, Math.max(2, 2 - Math.floor(Math.log10(co))));
  return value.toFixed(decimals).replace(/\.?0+$/, '');
}

export function grouped(value: number | bigint): string {
  return value.toString().replace(/\B(?=(\d{3})+(?!\d))/g, ',');
}

// "1 job", "2,000 jobs".
export function counted(value: number | bigint, what: string): string {
  return `${grouped(value)} ${what}${Number(value) === 1 ? '' : 's'}`;
}

export function bytes(value: number): string {
  const units = ['B', 'kB', 'MB', 'GB', 'TB'];
  let unit = 0;
  let left = value;
  while (left >= 1000 && unit < units.length - 1) {
    left /= 1000;
    unit += 1;
  }
  return `${significant(left, 3)} ${units[unit]}`;
}

export function duration(seconds: number): string {
  const s = Math.max(0, Math.round(seconds));
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${s % 60} s`;
  if (s < 86_400) return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
  return `${Math.floor(s / 86_400)} d ${Math.floor((s % 86_400) / 3600)} h`;
}

// An argument of a command line, quoted where a shell would misread it.
export function quoted(text: string): string {
  return /^[\p{L}\p{N}_.,/:@=+-]+$/u.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}

// A share of the work, rounded down, so that 100 % means done.
export function percent(share: number): string {
  return `${Math.floor(1000 * share) / 10} %`;
}
