// Whether the farm and this page's own server can be reached, for the banner on top.
type Kind = 'farm' | 'page';

class Link {
  // What does not answer, and why.
  farm = $state<string | null>(null);
  page = $state<string | null>(null);

  reached(what: Kind): void {
    this.page = null;
    if (what === 'farm') this.farm = null;
  }

  lost(what: Kind, why: string): void {
    this[what] = why;
  }
}

export const link = new Link();
