// A device at a serial port of this computer, watched by the page alone. It moves nothing: that needs the program, which supervises
// every motion. Browsers with Web Serial have it (Chromium and its relatives).

const BAUD = 460800;
/** A device that has not answered within this time is greeted again. */
const GREET_MS = 600;
const MOST_GREETINGS = 10;
/** After so long without a byte it is greeted again: it has restarted, or another program had switched its samples off. */
const SILENT_MS = 2000;

const watched = { text: 'No port is open.', source: null };

const canWatch = () => !isServed() && 'serial' in navigator;

function drawWatched(text) {
  if (text !== undefined) watched.text = text;
  if (state.view === 'live' && live.draw) requestAnimationFrame(() => { if (state.view === 'live' && live.draw) live.draw(); });
}

/** Lets the person choose a port, and follows what the device at it sends until the port is closed. */
async function watchPort() {
  let port;
  try {
    port = await navigator.serial.requestPort();
    await port.open({ baudRate: BAUD, bufferSize: 2 ** 16 });
  } catch (error) {
    // The person chose no port.
    if (error.name === 'NotFoundError') return;
    throw new Error(`the port cannot be opened: ${error.message}; another program uses it, or the device was disconnected`);
  }
  const [reader, writer] = [port.readable.getReader(), port.writable.getWriter()];
  const source = { close: () => reader.cancel().catch(() => {}) };
  watched.source = source;
  Object.assign(live, { socket: source, points: [], counts: null, arrived: [], isFresh: true });
  drawWatched('Waiting for an answer.');
  let ended = 'The port is closed.';
  let [id, greetings, arrivedAt, streams, isAsking] = [0, 0, performance.now(), null, false];
  const ask = async () => {
    if (isAsking) return;
    isAsking = true;
    try {
      const token = live.counts ? live.counts.connection : null;
      const isSilent = performance.now() - arrivedAt > SILENT_MS;
      if (live.counts && live.counts.other_version !== null) {
        ended = `The device uses protocol version ${live.counts.other_version}, and this page another one: use the page of that version.`;
        source.close();
      } else if (token !== null && token !== streams) {
        streams = token;
        await writer.write(await engine.ask(id, token));
        drawWatched('Watching.');
      } else if (token === null || isSilent) {
        if (greetings === MOST_GREETINGS) {
          ended = token === null ? 'No answer: this is another device, or it has no firmware.' : 'The device does not answer any more.';
          source.close();
          return;
        }
        greetings += 1;
        await writer.write(await engine.ask(id, null));
        if (isSilent) drawWatched('The device is silent.');
      }
      id = (id + 1) % 2 ** 16;
    } catch (error) {
      ended = `The port is gone: ${error.message}`;
      source.close();
    } finally {
      isAsking = false;
    }
  };
  const timer = setInterval(ask, GREET_MS);
  ask();
  try {
    for (;;) {
      const { value, done } = await reader.read();
      if (done) break;
      arrivedAt = performance.now();
      greetings = 0;
      if (live.socket === source) followLive(value).then(() => drawWatched());
    }
  } catch (error) {
    ended = `The port is gone: ${error.message}`;
  } finally {
    clearInterval(timer);
    reader.releaseLock();
    writer.releaseLock();
    watched.source = null;
    await port.close().catch(() => {});
    drawWatched(ended);
  }
}

/** State and readings of the device, from its frames. */
function watchedRows() {
  const { counts, points } = live;
  if (!counts) return [];
  const last = points[points.length - 1];
  const middle = (channel) => (last ? number(0.5 * (last.low[channel] + last.high[channel]), 4) : '-');
  return [
    ['State', counts.state ?? '-'],
    ['Fault', counts.fault === null ? 'none' : `${counts.fault.number} (${counts.fault.name}): guide status states its cause and remedy`],
    ['Force x, y', `${middle(0)}, ${middle(1)} N`],
    ['Position x, y', `${middle(2)}, ${middle(3)} mm`],
    ['Decoded here', decodedText(counts)],
  ];
}

function watchSection() {
  const text = h('p', { id: 'watched', role: 'status' });
  const button = h('button', { type: 'button', class: 'primary', id: 'watch', onclick: () => {
    if (watched.source) watched.source.close(); else watchPort().catch((error) => fail(error));
  } });
  const update = () => {
    if (text.textContent !== watched.text) text.textContent = watched.text;
    const label = watched.source ? 'Close the port' : 'Choose a serial port';
    if (button.textContent !== label) button.textContent = label;
  };
  update();
  return [section('A device at this computer', h('p', {}, 'The page shows what the device measures and moves nothing. To move it, start the program: guide web --port.'), h('p', { class: 'bar' }, button), text), update];
}
