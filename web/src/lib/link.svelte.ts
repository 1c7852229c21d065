// Whether the farm can be reached, for the banner on top.
type Trouble = { kind: 'farm' | 'token'; why: string };

class Link {
  trouble = $state<Trouble | null>(null);

  reached(): void {
    if (this.trouble) this.trouble = null;
  }

  lost(kind: Trouble['kind'], why: string): void {
    this.trouble = { kind, why };
  }
}

export const link = new Link();
