// Keeps whether the page is visible: a tab in the background needs no stream, and browsers allow six connections.
class Visible {
  now = $state(document.visibilityState === 'visible');

  constructor() {
    document.addEventListener('visibilitychange', () => (this.now = document.visibilityState === 'visible'));
  }
}

export const visible = new Visible();
