import type { Files } from '../gen/desk/v1/desk_pb';

// Saves files where the browser keeps downloads.
export function save(files: Files): void {
  for (const { name, mediaType, content } of files.files) {
    const url = URL.createObjectURL(new Blob([content as BlobPart], { type: mediaType }));
    const anchor = document.createElement('a');
    anchor.href = url;
    anchor.download = name;
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(url), 10_000);
  }
}
