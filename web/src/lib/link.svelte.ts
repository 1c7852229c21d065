// Keeps whether the farm and this page's server can be reached, for the banner on top.
type Kind = 'farm' | 'page';

class Link {
  // Reasons why the page's server or the farm cannot be reached.
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

// An error of this page's server, whose message is for users.
export class Failure extends Error {}
