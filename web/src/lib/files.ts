import { zipSync } from 'fflate';
import type { Files } from '../gen/desk/v1/desk_pb';

// Saves files where the browser keeps downloads. Browsers let a page save one file a click, so several go into an
// archive of this name.
export function save({ files }: Files, archive: string): void {
  const [first, ...others] = files;
  if (!first) return;
  if (others.length === 0) offer(first.name, first.mediaType, first.content);
  else offer(`${archive}.zip`, 'application/zip', zipSync(Object.fromEntries(files.map((f) => [f.name, f.content]))));
}

function offer(name: string, type: string, content: Uint8Array): void {
  const url = URL.createObjectURL(new Blob([content as BlobPart], { type }));
  const anchor = document.createElement('a');
  anchor.href = url;
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
