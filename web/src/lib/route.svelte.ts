// The state in a link: a tab and its parameters, as in #/dictionary?name=paper&g=0.4.
export const PLACES = ['measure', 'dictionary', 'farm', 'capture'] as const;
export type Place = (typeof PLACES)[number];

function read(): { place: Place; parameters: URLSearchParams } {
  const [path = '', query = ''] = window.location.hash.replace(/^#\/?/, '').split('?');
  const place = PLACES.find((own) => own === path) ?? 'measure';
  return { place, parameters: new URLSearchParams(query) };
}

class Route {
  place = $state<Place>('measure');
  parameters = $state.raw(new URLSearchParams());

  constructor() {
    this.#take();
    window.addEventListener('hashchange', () => this.#take());
  }

  #take(): void {
    const { place, parameters } = read();
    this.place = place;
    this.parameters = parameters;
  }

  get(name: string): string | null {
    return this.parameters.get(name);
  }

  number(name: string): number | null {
    const value = Number.parseFloat(this.get(name) ?? '');
    return Number.isFinite(value) ? value : null;
  }

  // Changes parameters without a new entry in the history: a link that is copied at any time restores the view.
  set(changes: Record<string, string | number | null>): void {
    const parameters = new URLSearchParams(this.parameters);
    for (const [name, value] of Object.entries(changes)) {
      if (value === null || value === '') parameters.delete(name);
      else parameters.set(name, String(value));
    }
    if (parameters.toString() === this.parameters.toString()) return;
    this.parameters = parameters;
    const query = parameters.toString();
    history.replaceState(null, '', `#/${this.place}${query ? `?${query}` : ''}`);
  }
}

export const route = new Route();
