import type { SavedFile } from './ask';

export type GivenFile = { name: string; base64: string };

// The content of a file as the page's server takes it.
export function given(file: File): Promise<GivenFile> {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    // A data URL, whose content follows a comma; that of an empty file may have none.
    reader.onload = () => resolve({ name: file.name, base64: String(reader.result).split(',')[1] ?? '' });
    reader.onerror = () => reject(new Error(`${file.name} cannot be read as a file; if it is a capture's folder, choose it from the list`));
    reader.readAsDataURL(file);
  });
}

// Saves a file as a download.
export function save({ name, base64 }: SavedFile): void {
  const type = name.endsWith('.svg') ? 'image/svg+xml' : 'application/octet-stream';
  const url = URL.createObjectURL(new Blob([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))], { type }));
  const anchor = document.createElement('a');
  anchor.href = url;
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
