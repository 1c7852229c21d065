// Clients of the farm's services, by gRPC-Web on this page's server.
import { Code, ConnectError, createClient, type Interceptor } from '@connectrpc/connect';
import { createGrpcWebTransport } from '@connectrpc/connect-web';
import { Admin } from '../gen/farm/v1/admin_pb';
import { Dictionaries } from '../gen/farm/v1/dictionaries_pb';
import { Farm } from '../gen/farm/v1/farm_pb';
import { Fits } from '../gen/farm/v1/fits_pb';
import { Measurements } from '../gen/farm/v1/measurements_pb';
import { ENTRANCE, SILENT } from './ask';
import { Failure, link } from './link.svelte';

// Updates on every answer whether the farm can be reached.
const watchLink: Interceptor = (next) => async (request) => {
  try {
    const answer = await next(request);
    link.reached('farm');
    return answer;
  } catch (error) {
    const { code, metadata, rawMessage } = ConnectError.from(error);
    // The page's server refuses with an HTTP status only, the farm with a gRPC status.
    const refused = code === Code.Unauthenticated && /^HTTP/.test(rawMessage);
    const silent = code === Code.Unknown || (code === Code.Unavailable && !metadata.has('grpc-status') && /^HTTP|fetch/i.test(rawMessage));
    if (request.signal.aborted || code === Code.Canceled) throw error;
    if (refused) link.lost('page', ENTRANCE);
    else if (silent) link.lost('page', SILENT);
    else if (code === Code.Unavailable) link.lost('farm', text(error));
    else link.reached('farm');
    throw error;
  }
};

// Relative to the page, at any path prefix of a proxy.
const baseUrl = new URL('.', window.location.href).href.replace(/\/$/, '');
const transport = createGrpcWebTransport({ baseUrl, interceptors: [watchLink], defaultTimeoutMs: 300_000 });

export const admin = createClient(Admin, transport);
export const dictionaries = createClient(Dictionaries, transport);
export const farm = createClient(Farm, transport);
export const fits = createClient(Fits, transport);
export const kept = createClient(Measurements, transport);

// The message of an error for users, as the server gave it.
export function text(error: unknown): string {
  if (error instanceof Failure) return error.message;
  const failure = ConnectError.from(error);
  if (failure.code === Code.Unavailable || failure.code === Code.Unknown) {
    return failure.rawMessage && !/fetch/i.test(failure.rawMessage) ? failure.rawMessage : SILENT;
  }
  return failure.rawMessage || 'something went wrong';
}

// Whether the coordinator is of an older version, without this call.
export function isMissing(error: unknown): boolean {
  return ConnectError.from(error).code === Code.Unimplemented;
}

export function isCancelled(error: unknown): boolean {
  return ConnectError.from(error).code === Code.Canceled;
}

// Whether the same call may succeed later.
export function passes(error: unknown): boolean {
  return [Code.Unavailable, Code.Unknown, Code.DeadlineExceeded, Code.ResourceExhausted, Code.Aborted].includes(
    ConnectError.from(error).code,
  );
}
