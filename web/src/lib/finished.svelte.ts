// Notices of dictionaries that were finished while the page is open: in the title, and as notifications if they are wanted.
import { DictionaryState, type Dictionary } from '../gen/farm/v1/dictionaries_pb';
import { listDictionaries } from './known.svelte';
import { counted } from './numbers';
import { route } from './route.svelte';

// Between two looks at the list while the Farm tab or the page is not visible.
const EVERY_MS = 10_000;
// Signs of success and failure.
const MARKS = { done: '✓', failed: '!' };

export type Notice = { name: string; mark: string; text: string };

class Finished {
  notices = $state.raw<Notice[]>([]);
  // Whether a dictionary is being computed.
  running = $state(false);
  permission = $state<NotificationPermission | null>('Notification' in window ? Notification.permission : null);
  #states: Map<string, DictionaryState> | null = null;
  #started = false;

  // Compares the list with the one before.
  take(all: Dictionary[]): void {
    const before = this.#states;
    this.#states = new Map(all.map((d) => [d.name, d.state]));
    this.running = all.some((d) => d.state === DictionaryState.RUNNING);
    for (const dictionary of before ? all : []) {
      const was = before?.get(dictionary.name);
      if (was === undefined || was === DictionaryState.RUNNING) this.#end(dictionary);
    }
    this.#start();
  }

  dismiss(): void {
    this.notices = [];
  }

  // Must be called by a press, as browsers require.
  async ask(): Promise<void> {
    try {
      this.permission = await Notification.requestPermission();
    } catch {
      this.permission = null;
    }
  }

  #end({ name, state, recordsTotal, jobsFailed }: Dictionary): void {
    if (state !== DictionaryState.DONE && state !== DictionaryState.FAILED) return;
    const isDone = state === DictionaryState.DONE;
    const mark = isDone ? MARKS.done : MARKS.failed;
    const text = isDone ? `${name} is done: ${counted(recordsTotal, 'record')}.` : `${name} has ended: ${counted(jobsFailed, 'job')} failed.`;
    this.notices = [{ name, mark, text }, ...this.notices.filter((notice) => notice.name !== name)];
    if (this.permission === 'granted') show(text);
  }

  // Watches in every tab of the page, from the first list on.
  #start(): void {
    if (this.#started) return;
    this.#started = true;
    $effect.root(() => {
      $effect(() => {
        if (!this.running) return;
        const timer = setInterval(() => void listDictionaries().then((all) => this.take(all), () => undefined), EVERY_MS);
        return () => clearInterval(timer);
      });
      $effect(() => {
        // Each tab of the page sets its own title first.
        void route.place;
        const mark = this.notices[0] ? `${this.notices[0].mark} ` : '';
        const timer = setTimeout(() => (document.title = mark + document.title.replace(/^[✓!] /, '')));
        return () => clearTimeout(timer);
      });
    });
  }
}

function show(text: string): void {
  try {
    new Notification('Resin farm', { body: text }).onclick = () => window.focus();
  } catch {
    // Some browsers allow notifications of service workers only.
  }
}

export const finished = new Finished();
