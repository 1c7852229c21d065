// Keeps whether the system's colour scheme is dark, for what is drawn on a canvas.
class Scheme {
  dark = $state(false);

  constructor() {
    const media = window.matchMedia('(prefers-color-scheme: dark)');
    this.dark = media.matches;
    media.addEventListener('change', () => (this.dark = media.matches));
  }
}

export const scheme = new Scheme();
