// Keeps the last dropped file over a reload of the page.
const DROPPED = 'measurement';
// Longer files are not kept: browsers allow some 5 MB.
const MOST_KEPT = 3_000_000;

export type Dropped = { name: string; content: Uint8Array };

export function keep(file: Dropped | null): void {
  try {
    sessionStorage.removeItem(DROPPED);
    if (file && file.content.length <= MOST_KEPT) {
      sessionStorage.setItem(DROPPED, JSON.stringify({ name: file.name, content: base64(file.content) }));
    }
  } catch {
    // Without space, the file has to be chosen again after a reload.
  }
}

export function dropped(): Dropped | null {
  const text = sessionStorage.getItem(DROPPED);
  if (!text) return null;
  const { name, content } = JSON.parse(text) as { name: string; content: string };
  return { name, content: Uint8Array.from(atob(content), (c) => c.charCodeAt(0)) };
}

function base64(content: Uint8Array): string {
  let binary = '';
  for (const byte of content) binary += String.fromCharCode(byte);
  return btoa(binary);
}
