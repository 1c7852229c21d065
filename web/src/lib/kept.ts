// Keeps the last dropped file over a reload of the page.
const KEPT = 'measurement';
const MEASURED = 'measured';
// Longer files are not kept: browsers allow some 5 MB.
const MOST_KEPT = 3_000_000;

export type Dropped = { name: string; content: Uint8Array };

export function keep(file: Dropped | null): void {
  try {
    sessionStorage.removeItem(KEPT);
    sessionStorage.removeItem(MEASURED);
    if (file && file.content.length <= MOST_KEPT) {
      sessionStorage.setItem(KEPT, JSON.stringify({ name: file.name, content: base64(file.content) }));
    }
  } catch {
    // Without space, the file has to be chosen again after a reload.
  }
}

// Stores that the file of this name was measured.
export function keepMeasured(name: string): void {
  sessionStorage.setItem(MEASURED, name);
}

export function wasMeasured(name: string): boolean {
  return sessionStorage.getItem(MEASURED) === name;
}

export function kept(): Dropped | null {
  const text = sessionStorage.getItem(KEPT);
  if (!text) return null;
  const { name, content } = JSON.parse(text) as { name: string; content: string };
  return { name, content: Uint8Array.from(atob(content), (c) => c.charCodeAt(0)) };
}

function base64(content: Uint8Array): string {
  let binary = '';
  for (const byte of content) binary += String.fromCharCode(byte);
  return btoa(binary);
}
