// Events of the farm for people: those that need attention, and the routine ones, with repeated ones joined.
import type { Event as FarmEvent } from '../gen/farm/v1/farm_pb';

// All other kinds need attention, those that the page has no word for among them.
const ROUTINE = new Set([
  'COORDINATOR_STARTED', 'SUBMITTED', 'DONE', 'PAUSED', 'RESUMED', 'CANCELLED', 'RETRIED', 'PRIORITY_CHANGED', 'DELETED',
  'WORKER_JOINED', 'WORKER_LEFT', 'WORKER_DRAINING', 'BACKUP_MADE',
]);

// The newest of equal events, and their number.
export type Joined = { event: FarmEvent; count: number };

function joined(events: FarmEvent[], key: (event: FarmEvent) => string): Joined[] {
  const found = new Map<string, Joined>();
  for (const event of events) {
    const before = found.get(key(event));
    if (before) before.count += 1;
    else found.set(key(event), { event, count: 1 });
  }
  return [...found.values()];
}

// Events in their order, the newest first.
export function sorted(events: FarmEvent[]): { serious: Joined[]; routine: Joined[] } {
  const isRoutine = (event: FarmEvent): boolean => ROUTINE.has(event.kind);
  return {
    serious: joined(events.filter((e) => !isRoutine(e)), (e) => [e.kind, e.dictionary, e.worker, e.message].join('\n')),
    routine: joined(events.filter(isRoutine), (e) => [e.kind, e.dictionary].join('\n')),
  };
}

export function kindText(event: FarmEvent): string {
  return event.kind.toLowerCase().replaceAll('_', ' ');
}

// The time, with the date unless it is today.
export function timeText(event: FarmEvent): string {
  const at = new Date(Number(event.unixMs));
  const time = at.toLocaleTimeString([], { hour: '2-digit', minute: '2-digit' });
  const isToday = at.toDateString() === new Date().toDateString();
  return isToday ? time : `${at.toLocaleDateString([], { month: 'short', day: 'numeric' })} ${time}`;
}
