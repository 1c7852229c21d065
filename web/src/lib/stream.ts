// Browsers allow six connections to a server, for all tabs together: streams that last must not take them all.
const STREAMS = 3;

// Runs `read`, and tells it whether its stream may last; otherwise it is to take what there is now and end.
export async function withStream(read: (lasting: boolean) => Promise<void>): Promise<void> {
  // Shared by all tabs, and freed with a tab that is closed. Pages that are no secure context have none.
  if (!('locks' in navigator)) return read(true);
  for (let place = 0; place < STREAMS; place++) {
    const had = await navigator.locks.request(`stream ${place}`, { ifAvailable: true }, async (lock) => {
      if (lock) await read(true);
      return lock !== null;
    });
    if (had) return;
  }
  return read(false);
}
