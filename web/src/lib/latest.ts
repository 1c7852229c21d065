// Runs one call at a time, followed by the newest of the requests that arrived meanwhile, as sliders need.
export function latest<Q, A>(ask: (question: Q) => Promise<A>, take: (answer: A) => void, fail: (error: unknown) => void) {
  let busy = false;
  let next: { question: Q } | null = null;
  async function run(question: Q): Promise<void> {
    busy = true;
    try {
      take(await ask(question));
    } catch (error) {
      fail(error);
    }
    busy = false;
    if (next) {
      const { question: newest } = next;
      next = null;
      void run(newest);
    }
  }
  return (question: Q): void => {
    if (busy) next = { question };
    else void run(question);
  };
}
