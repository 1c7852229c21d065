// Keeps the last dropped file over a reload of the page.
import type { GivenFile } from './files';

const DROPPED = 'measurement';
// Longer files are not kept: browsers allow some 5 MB.
const MOST_KEPT = 4_000_000;

export function keep(file: GivenFile | null): void {
  try {
    sessionStorage.removeItem(DROPPED);
    if (file && file.base64.length <= MOST_KEPT) sessionStorage.setItem(DROPPED, JSON.stringify(file));
  } catch {
    // Without space, the file has to be chosen again after a reload.
  }
}

export function dropped(): GivenFile | null {
  const text = sessionStorage.getItem(DROPPED);
  return text ? (JSON.parse(text) as GivenFile) : null;
}
