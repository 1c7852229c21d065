import { zipSync } from 'fflate';
import type { File, Files } from '../gen/desk/v1/desk_pb';

// Saves files as downloads. Browsers allow one download per click, so several files go into an archive of this name.
export function save({ files }: Files, archive: string): void {
  const [first, ...others] = files;
  if (!first) return;
  if (others.length === 0) offer(first.name, first.mediaType, first.content);
  else offer(`${archive}.zip`, 'application/zip', zipSync(named(files)));
}

// Files by name; duplicate names get a number.
function named(files: readonly File[]): Record<string, Uint8Array> {
  const all: Record<string, Uint8Array> = {};
  for (const { name, content } of files) {
    let free = name;
    for (let i = 2; free in all; i++) free = name.replace(/(\.[^.]*)?$/, `-${i}$1`);
    all[free] = content;
  }
  return all;
}

function offer(name: string, type: string, content: Uint8Array): void {
  const url = URL.createObjectURL(new Blob([content as BlobPart], { type }));
  const anchor = document.createElement('a');
  anchor.href = url;
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
