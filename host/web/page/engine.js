// The engine behind promises: a worker for every kind of work, so that a slider does not wait for a slow computation.

const FOLLOWED = 'live';

class Engine {
  constructor() {
    this.source = URL.createObjectURL(new Blob([document.getElementById('worker').textContent], { type: 'text/javascript' }));
    this.files = [];
    this.lanes = new Map();
    const first = this.start();
    this.lanes.set('quick', first);
    this.ready = first.send('load', document.getElementById('engine').textContent.trim()).then((module) => { this.module = module; });
  }

  /** A worker with the engine and the session's files, by its name. */
  lane(name) {
    if (!this.lanes.has(name)) {
      const made = this.start();
      made.send('load', this.module);
      // Following a device does not depend on the session, and goes on when another one is opened.
      if (name !== FOLLOWED) made.send('files', this.files);
      this.lanes.set(name, made);
    }
    return this.lanes.get(name);
  }

  start() {
    const worker = new Worker(this.source);
    const waiting = new Map();
    let next = 0;
    worker.onmessage = ({ data: { id, step, result, fault } }) => {
      const one = waiting.get(id);
      if (!one) return;
      if (step !== undefined) { one.onStep(step); return; }
      waiting.delete(id);
      if (fault !== undefined) one.reject(new EngineStopped(fault)); else one.resolve(result);
    };
    worker.onerror = (event) => {
      event.preventDefault();
      waiting.forEach((one) => one.reject(new EngineStopped(event.message || 'the worker cannot be started')));
      waiting.clear();
    };
    const send = (kind, content, onStep = () => {}) => new Promise((resolve, reject) => {
      next += 1;
      waiting.set(next, { resolve, reject, onStep });
      worker.postMessage({ id: next, kind, content });
    });
    const stop = () => {
      worker.terminate();
      waiting.forEach((one) => one.reject(new Cancelled()));
      waiting.clear();
    };
    return { send, stop };
  }

  async open(files) {
    await this.ready;
    this.files = files;
    await Promise.all([...this.lanes].filter(([name]) => name !== FOLLOWED).map(([, lane]) => lane.send('files', files)));
  }

  async request(name, content, onStep) {
    await this.ready;
    const answer = await this.lane(name).send('run', content, onStep);
    if (answer.error !== undefined) throw new Error(answer.error);
    return answer.ok;
  }

  /** Statistics over many sessions, in a worker whose files are their records. */
  async population(files, by) {
    await this.ready;
    await this.lane('population').send('files', files);
    return this.request('population', { do: 'population', files: files.map(([path]) => path), by });
  }

  /** Decodes what the device has sent since the last time. */
  async follow(data, fresh) {
    await this.ready;
    await this.lane(FOLLOWED).send('file', ['frames', data]);
    return this.request(FOLLOWED, { do: 'follow', file: 'frames', fresh });
  }

  /** The frame that greets a device, or, with the token of its answer, has it send samples. */
  async ask(id, connection) {
    await this.ready;
    return Uint8Array.from(await this.request(FOLLOWED, { do: 'ask', id, connection }));
  }

  /** Ends a slow computation; the next request gets a new worker. */
  cancel(name) {
    this.lanes.get(name)?.stop();
    this.lanes.delete(name);
  }
}

class Cancelled extends Error {}
class EngineStopped extends Error {}

/** Runs one request at a time; of those that arrive meanwhile only the last one is kept. */
function latest(run) {
  let isRunning = false;
  let waiting = null;
  return async function next(...values) {
    if (isRunning) { waiting = values; return; }
    isRunning = true;
    try {
      await run(...values);
    } finally {
      isRunning = false;
      if (waiting) {
        const last = waiting;
        waiting = null;
        next(...last);
      }
    }
  };
}
