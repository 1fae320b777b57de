// SPDX-License-Identifier: Apache-2.0
// The data of the page: arrays come as text in base 64 and leave as typed arrays.

function unpack(value) {
  if (Array.isArray(value)) return value.map(unpack);
  if (value === null || typeof value !== 'object') return value;
  if ('f32' in value) return new Float32Array(bytes(value.f32));
  if ('u32' in value) return new Uint32Array(bytes(value.u32));
  return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, unpack(inner)]));
}

function bytes(text) {
  const raw = atob(text);
  const array = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i += 1) array[i] = raw.charCodeAt(i);
  return array.buffer;
}

// Index of the last time that is not after `time`; -1: all are after it.
function lastBefore(times, time) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

const element = (id) => document.getElementById(id);
const run = unpack(JSON.parse(element('data').textContent));
