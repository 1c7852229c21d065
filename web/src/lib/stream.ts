// Browsers allow six connections per server, for all tabs together, so long streams must not use them all.
const STREAMS = 3;

// Runs `read` with a flag: whether its stream may stay open. Otherwise it should read the current state and end.
export async function withStream(read: (lasting: boolean) => Promise<void>): Promise<void> {
  // The lock is shared by all tabs and released when a tab is closed. It exists in secure contexts only.
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
