// Polls while the page is visible; returns a function that ends it. After a failure it continues more slowly. As an
// answer may arrive after the end, `ask` gets a function that returns whether polling has ended.
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
