// Colours for people with colour blindness (Okabe and Ito), and one scale for maps (viridis, interpolated between nine
// values).
export const COLORS = ['#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9'] as const;

// Line styles, so that lines can be distinguished without their colours.
const DASHES: readonly (readonly number[])[] = [[], [8, 4], [2, 3], [10, 3, 2, 3], [5, 2], [14, 5], [1, 5], [9, 2, 2, 2, 2, 2]];

export function dash(i: number): readonly number[] {
  return DASHES[i % DASHES.length]!;
}

// The colour as it is drawn: on a dark ground the two blues change places, since the darker one is hard to see there.
export function onGround(color: string, dark: boolean): string {
  const [blue, sky] = [COLORS[0], COLORS[5]];
  if (!dark) return color;
  return color === blue ? sky : color === sky ? blue : color;
}

// The colour of a channel, as in the figures of farmctl: red, green and blue have similar ones.
export function channelColor(name: string, i: number): string {
  const place = { R: 1, G: 2, B: 0 }[name] ?? i;
  return COLORS[place % COLORS.length]!;
}

// Cells without a value.
export const NO_DATA: [number, number, number] = [150, 150, 150];

const VIRIDIS: readonly [number, number, number][] = [
  [68, 1, 84],
  [71, 44, 122],
  [59, 81, 139],
  [44, 113, 142],
  [33, 144, 141],
  [39, 173, 129],
  [92, 200, 99],
  [170, 220, 50],
  [253, 231, 37],
];

// The colour of a share from 0 (yellow: near) to 1 (dark: far).
export function near(share: number): [number, number, number] {
  const place = (1 - Math.min(1, Math.max(0, share))) * (VIRIDIS.length - 1);
  const low = Math.min(VIRIDIS.length - 2, Math.floor(place));
  const [a, b] = [VIRIDIS[low]!, VIRIDIS[low + 1]!];
  const t = place - low;
  return [0, 1, 2].map((i) => Math.round(a[i]! + t * (b[i]! - a[i]!))) as [number, number, number];
}

// A radiance factor of each channel as the colour of a screen (sRGB).
export function screenColor([r, g, b]: readonly [number, number, number]): string {
  const code = (v: number): number => {
    const linear = Math.min(1, Math.max(0, v));
    const coded = linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055;
    return Math.round(255 * coded);
  };
  return `rgb(${code(r)} ${code(g)} ${code(b)})`;
}
