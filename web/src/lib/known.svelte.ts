// The farm's dictionaries, and what was measured last: shared by the places.
import type { Measurement } from '../gen/farm/v1/model_pb';
import { DictionaryState, type Dictionary } from '../gen/farm/v1/dictionaries_pb';
import type { MessageInitShape } from '@bufbuild/protobuf';
import type { FitOptionsSchema, MeasureResponse } from '../gen/farm/v1/fits_pb';
import type { Note, OpenCaptureResponse, TellResponse } from '../gen/desk/v1/desk_pb';
import { dictionaries } from './api';

export const STATES: Record<DictionaryState, string> = {
  [DictionaryState.UNSPECIFIED]: '',
  [DictionaryState.RUNNING]: 'running',
  [DictionaryState.DONE]: 'done',
  [DictionaryState.FAILED]: 'some jobs failed',
  [DictionaryState.PAUSED]: 'paused',
  [DictionaryState.CANCELLED]: 'cancelled',
  [DictionaryState.OUTDATED]: 'of another physics version',
};

// All pages of the list; there are seldom more than one.
export async function listDictionaries(): Promise<Dictionary[]> {
  const all: Dictionary[] = [];
  let pageToken = '';
  do {
    const page = await dictionaries.list({ pageToken });
    all.push(...page.dictionaries);
    pageToken = page.nextPageToken;
  } while (pageToken !== '');
  return all;
}

export type Options = Exclude<MessageInitShape<typeof FitOptionsSchema>, { $unknown?: unknown }>;

// An answer, and what it was asked with: the choices on the page may be others by now.
export type Answer = {
  found: MeasureResponse;
  told: TellResponse;
  colors: Map<string, [number, number, number]>;
  dictionary: string;
  options: Options;
  line: string;
};

class Measured {
  // Of the file, or of the capture's folder.
  name = $state('');
  capture = $state.raw<OpenCaptureResponse | null>(null);
  materials = $state.raw<Measurement[]>([]);
  notes = $state.raw<Note[]>([]);
  answer = $state.raw<Answer | null>(null);
}

export const measured = new Measured();
