// Asks again and again while somebody looks; returns what ends it. After a failure it goes on, more slowly. An answer
// may come after the end: `ask` is told.
export function poll(everyMs: number, ask: (ended: () => boolean) => Promise<void>): () => void {
  let timer: ReturnType<typeof setTimeout> | undefined;
  let ended = false;
  async function round(): Promise<void> {
    let pause = everyMs;
    if (document.visibilityState === 'visible') {
      try {
        await ask(() => ended);
      } catch {
        pause = Math.max(everyMs, 2000);
      }
    }
    if (!ended) timer = setTimeout(round, pause);
  }
  const shown = (): void => {
    if (document.visibilityState === 'visible' && !ended) {
      clearTimeout(timer);
      void round();
    }
  };
  document.addEventListener('visibilitychange', shown);
  void round();
  return () => {
    ended = true;
    clearTimeout(timer);
    document.removeEventListener('visibilitychange', shown);
  };
}
