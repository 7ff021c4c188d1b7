'use strict';
// Runs the engine: a WASI program whose file system is a map of names to bytes, and whose standard input is one request.

const [EBADF, EINVAL, ENOENT, ENOSYS] = [8, 28, 44, 52];
const [DIRECTORY, CHARACTERS, REGULAR] = [3, 2, 4];
const ROOT = 3;

const files = new Map();
const opened = new Map();
let module = null;
let instance = null;
let isStarted = false;
let input = new Uint8Array();
let output = [];
let lines = '';
let onLine = () => {};
let nextFd = ROOT + 1;

const view = () => new DataView(instance.exports.memory.buffer);
const bytes = (at, length) => new Uint8Array(instance.exports.memory.buffer, at, length);
const pathOf = (at, length) => new TextDecoder().decode(bytes(at, length)).replace(/^\.?\/+/, '');
const isFolder = (path) => path === '' || [...files.keys()].some((name) => name.startsWith(path + '/'));

function buffers(at, count) {
  const all = [];
  for (let i = 0; i < count; i += 1) {
    all.push([view().getUint32(at + 8 * i, true), view().getUint32(at + 8 * i + 4, true)]);
  }
  return all;
}

function writeStat(at, type, size) {
  bytes(at, 64).fill(0);
  view().setUint8(at + 16, type);
  view().setBigUint64(at + 24, 1n, true);
  view().setBigUint64(at + 32, BigInt(size), true);
  return 0;
}

/** Standard error: every whole line is a step. */
function note(text) {
  lines += text;
  const whole = lines.split('\n');
  lines = whole.pop();
  whole.filter(Boolean).forEach((line) => onLine(line));
}

class Exit extends Error {}

const wasi = {
  args_sizes_get: (count, size) => { view().setUint32(count, 0, true); view().setUint32(size, 0, true); return 0; },
  args_get: () => 0,
  environ_sizes_get: (count, size) => { view().setUint32(count, 0, true); view().setUint32(size, 0, true); return 0; },
  environ_get: () => 0,
  clock_time_get: (_id, _precision, at) => {
    view().setBigUint64(at, BigInt(Math.round(1e6 * performance.now())), true);
    return 0;
  },
  random_get: (at, length) => { crypto.getRandomValues(bytes(at, length)); return 0; },
  sched_yield: () => 0,
  proc_exit: (code) => { throw new Exit(`the engine ended with code ${code}`); },
  fd_prestat_get: (fd, at) => {
    if (fd !== ROOT) return EBADF;
    view().setUint32(at, 0, true);
    view().setUint32(at + 4, 1, true);
    return 0;
  },
  fd_prestat_dir_name: (fd, at) => {
    if (fd !== ROOT) return EBADF;
    bytes(at, 1)[0] = 47;
    return 0;
  },
  fd_fdstat_get: (fd, at) => {
    if (fd > ROOT && !opened.has(fd)) return EBADF;
    bytes(at, 24).fill(0);
    view().setUint8(at, fd === ROOT ? DIRECTORY : fd < ROOT ? CHARACTERS : REGULAR);
    view().setBigUint64(at + 8, 0x1fffffffn, true);
    view().setBigUint64(at + 16, 0x1fffffffn, true);
    return 0;
  },
  fd_fdstat_set_flags: () => 0,
  path_open: (_fd, _lookup, at, length, flags, _base, _inheriting, _fdflags, result) => {
    const path = pathOf(at, length);
    // The engine may neither create nor truncate files.
    if (flags & 0b1001) return EINVAL;
    if (!files.has(path)) return ENOENT;
    const fd = nextFd;
    nextFd += 1;
    opened.set(fd, { content: files.get(path), at: 0 });
    view().setUint32(result, fd, true);
    return 0;
  },
  path_filestat_get: (_fd, _lookup, at, length, result) => {
    const path = pathOf(at, length);
    if (files.has(path)) return writeStat(result, REGULAR, files.get(path).length);
    return isFolder(path) ? writeStat(result, DIRECTORY, 0) : ENOENT;
  },
  fd_filestat_get: (fd, result) => {
    if (fd < ROOT) return writeStat(result, CHARACTERS, 0);
    if (fd === ROOT) return writeStat(result, DIRECTORY, 0);
    const file = opened.get(fd);
    return file ? writeStat(result, REGULAR, file.content.length) : EBADF;
  },
  fd_read: (fd, at, count, result) => {
    const file = fd === 0 ? input : opened.get(fd);
    if (!file) return EBADF;
    let read = 0;
    for (const [to, length] of buffers(at, count)) {
      const part = file.content.subarray(file.at, file.at + length);
      bytes(to, part.length).set(part);
      file.at += part.length;
      read += part.length;
    }
    view().setUint32(result, read, true);
    return 0;
  },
  fd_write: (fd, at, count, result) => {
    if (fd !== 1 && fd !== 2) return EBADF;
    let written = 0;
    for (const [from, length] of buffers(at, count)) {
      const part = bytes(from, length).slice();
      if (fd === 1) output.push(part); else note(new TextDecoder().decode(part));
      written += length;
    }
    view().setUint32(result, written, true);
    return 0;
  },
  fd_seek: (fd, offset, whence, result) => {
    const file = opened.get(fd);
    if (!file) return EBADF;
    const from = [0, file.at, file.content.length][whence];
    file.at = Math.max(0, from + Number(offset));
    view().setBigUint64(result, BigInt(file.at), true);
    return 0;
  },
  fd_close: (fd) => (opened.delete(fd) ? 0 : EBADF),
};
const imports = { wasi_snapshot_preview1: new Proxy(wasi, { get: (own, name) => own[name] ?? (() => ENOSYS) }) };

/** The answer of the engine. After a panic the next request gets a new engine. */
function run(request, step) {
  const all = [];
  onLine = (line) => { all.push(line); step(line); };
  input = { content: new TextEncoder().encode(request), at: 0 };
  output = [];
  lines = '';
  try {
    if (!instance) {
      instance = new WebAssembly.Instance(module, imports);
      isStarted = false;
    }
    // The first call prepares the program too; it calls the same entry point.
    if (isStarted) instance.exports.__main_void(); else instance.exports._start();
    isStarted = true;
  } catch (fault) {
    instance = null;
    opened.clear();
    throw new Error(all.length > 0 ? all.slice(-3).join(' ') : fault.message);
  }
  return new Blob(output).text();
}

async function load(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
  return WebAssembly.compile(await new Response(stream).arrayBuffer());
}

let last = Promise.resolve();

async function serve({ id, kind, content }) {
  try {
    let result = null;
    if (kind === 'load') {
      module = typeof content === 'string' ? await load(content) : content;
      result = module;
    } else if (kind === 'files') {
      files.clear();
      instance = null;
      content.forEach(([name, data]) => files.set(name, data));
    } else if (kind === 'file') {
      files.set(...content);
    } else {
      result = JSON.parse(await run(JSON.stringify(content), (step) => postMessage({ id, step })));
    }
    postMessage({ id, result });
  } catch (fault) {
    postMessage({ id, fault: fault.message });
  }
}

onmessage = (event) => {
  last = last.then(() => serve(event.data));
};
