// The device live, as `guide web --port` serves it, or at a serial port of the browser (`serial.js`). The page shows and requests; the program decides, and stops the device when the
// page in control does not answer its updates any more.

const KEPT_S = 30;
const LONGEST_GAP_S = 0.3;
const RETRY_MS = 1000;
/** The plots are drawn once per this number of updates. */
const PLOT_EVERY = 2;

/** Bytes that may wait to be decoded; more are given up, and count as lost. */
const MOST_WAITING = 4 * 2 ** 20;

const live = { isOffered: false, socket: null, last: null, points: [], counts: null, arrived: [], isFresh: true, isFollowing: false, waits: false, draw: null };

const hasControl = () => live.last !== null && live.last.control === 'this';

function requestLive(content) {
  if (live.socket && live.socket.readyState === WebSocket.OPEN) live.socket.send(JSON.stringify(content));
}

/** Asks the program whether it has a device, and then receives its updates. */
async function beginLive() {
  try {
    live.isOffered = (await listServed()).device;
  } catch (error) {
    fail(error, () => location.reload());
  }
  if (!live.isOffered) return;
  const stop = document.getElementById('stop');
  stop.hidden = false;
  stop.addEventListener('click', () => requestLive({ do: 'stop' }));
  // Before any button gets the key: space stops on every view while something moves, and always on this one.
  window.addEventListener('keydown', (event) => {
    if (event.key !== ' ' || (state.view !== 'live' && !isMoving())) return;
    event.preventDefault();
    event.stopPropagation();
    requestLive({ do: 'stop' });
  }, true);
  window.addEventListener('keyup', (event) => { if (event.key === ' ' && state.view === 'live') event.preventDefault(); }, true);
  // A page that is not shown gives up control at once; if that message is lost, the program misses the heartbeat of the page.
  document.addEventListener('visibilitychange', () => { if (document.visibilityState !== 'visible' && hasControl()) requestLive({ do: 'leave' }); });
  window.addEventListener('pagehide', () => { if (hasControl()) requestLive({ do: 'leave' }); });
  connectLive();
}

const isMoving = () => live.last !== null && live.last.device.state !== null && !['idle', 'faulted'].includes(live.last.device.state);

function connectLive() {
  const socket = new WebSocket(`ws://${location.host}${location.pathname}live`);
  live.socket = socket;
  socket.binaryType = 'arraybuffer';
  Object.assign(live, { points: [], counts: null, arrived: [], isFresh: true });
  socket.onmessage = ({ data }) => {
    if (typeof data !== 'string') { followLive(new Uint8Array(data)); return; }
    live.last = JSON.parse(data);
    if (live.waits) return;
    live.waits = true;
    // A browser draws no frame of a page that is hidden or frozen: then there is no heartbeat.
    requestAnimationFrame(() => {
      live.waits = false;
      if (state.view === 'live' && live.draw) live.draw();
      if (hasControl() && document.visibilityState === 'visible') requestLive({ do: 'heartbeat', update: live.last.update });
    });
  };
  socket.onclose = () => {
    live.last = null;
    if (state.view === 'live' && live.draw) live.draw();
    setTimeout(connectLive, RETRY_MS);
  };
}

/** Decodes what the device has sent, in order and one part after the other; of the columns those of the last half minute are kept. */
async function followLive(data) {
  live.arrived.push(data);
  if (live.arrived.reduce((sum, part) => sum + part.length, 0) > MOST_WAITING) live.arrived = [data];
  if (live.isFollowing) return;
  live.isFollowing = true;
  try {
    while (live.arrived.length > 0) {
      const { arrived, isFresh, socket } = live;
      Object.assign(live, { arrived: [], isFresh: false });
      const whole = new Uint8Array(arrived.reduce((sum, part) => sum + part.length, 0));
      arrived.reduce((at, part) => { whole.set(part, at); return at + part.length; }, 0);
      const { columns, ...counts } = await engine.follow(whole, isFresh);
      // These columns belong to a connection that has ended meanwhile.
      if (socket !== live.socket) continue;
      live.counts = counts;
      const [first] = columns;
      const kept = first ? live.points.filter((point) => point.index < first.index) : live.points;
      const all = [...kept, ...columns];
      live.points = all.filter((point) => point.time_s > all[all.length - 1].time_s - KEPT_S);
    }
  } catch (error) {
    // A decoder that has stopped begins again with a new connection, which starts with what is needed to read the rest.
    if (state.view === 'live') fail(error);
    live.socket.close();
  } finally {
    live.isFollowing = false;
  }
}

/** Series of a channel with its extremes, cut where nothing was measured. */
function traceOf(channel, style, label) {
  const runs = [];
  let previous = null;
  live.points.forEach((point) => {
    if (previous === null || point.time_s - previous > LONGEST_GAP_S) runs.push([]);
    runs[runs.length - 1].push(point);
    previous = point.time_s;
  });
  const newest = previous === null ? 0 : previous;
  return runs.flatMap((run, index) => {
    const x = run.map((point) => point.time_s - newest);
    const [low, high] = ['low', 'high'].map((end) => run.map((point) => point[end][channel]));
    const middle = low.map((value, i) => 0.5 * (value + high[i]));
    return [{ kind: 'band', x, low, high, style }, { kind: 'line', x, y: middle, style, ...(index === 0 ? { label } : {}) }];
  });
}

const decodedText = (decoded) => `samples ${decoded.samples}, lost ${decoded.samples_missing}; frames ${decoded.frames}, lost ${decoded.frames_missing + decoded.frames_corrupt + decoded.frames_unreadable}`;

function liveRows({ device }, decoded) {
  const pair = (x, y, unit, digits = 4) => `${number(x, digits)}, ${number(y, digits)} ${unit}`;
  const stiffness = (one) => (one ? `${number(one.n_per_mm)} (${interval(one.ci95_n_per_mm)}) N/mm` : '-');
  const fault = device.fault ? `${device.fault.number}: ${device.fault.cause}; ${device.fault.remedy}` : 'none';
  const counted = device.link;
  const lost = counted.frames_missing + counted.frames_corrupt + counted.frames_unreadable;
  return [
    ['Device', device.connected ? `${device.port}, connected` : `${device.port}: ${device.lost_because || 'not connected'}`],
    ['State', device.state ? `${device.state}${device.step === null ? '' : `, step ${device.step + 1}`}` : '-'],
    ['Fault', fault],
    ...(device.parted || []).map((words) => ['Model', capital(words)]),
    ['Force x, y', pair(device.force_x_n, device.force_y_n, 'N')],
    ['Position x, y', pair(device.position_x_mm, device.position_y_mm, 'mm')],
    ['Stiffness x', stiffness(device.stiffness_x)],
    ['Stiffness y', stiffness(device.stiffness_y)],
    ['Decoded here', decoded ? decodedText(decoded) : 'nothing yet'],
    ['Link', `${number(counted.samples_per_s, 4)} samples/s, ${number(counted.bytes_per_s / 1e3)} kB/s; samples lost ${counted.samples_missing}, frames lost ${lost}`],
  ];
}

function showLive() {
  const [force, position] = ['drawn', 'drawn'].map((name) => h('div', { class: name }));
  const rows = h('tbody', {});
  const outcome = h('p', { id: 'live-outcome', role: 'status' });
  const progress = h('progress', { id: 'live-progress', 'aria-label': 'Steps of the program', hidden: true });
  const held = h('p', { id: 'live-control' });
  const request = (content) => () => requestLive(content);
  const button = (label, content, more = {}) => h('button', { type: 'button', class: 'motion', onclick: typeof content === 'function' ? content : request(content), ...more }, label);
  const control = h('button', { type: 'button', class: 'primary', id: 'live-take', onclick: () => requestLive({ do: hasControl() ? 'leave' : 'take' }) }, 'Take control');
  const step = h('select', { id: 'live-step' }, ...[0.01, 0.1, 0.5, 1].map((mm) => h('option', { value: mm, selected: mm === 0.1 }, `${mm} mm`)));
  const jog = (label, x, y) => button(label, () => requestLive({ do: 'jog', x_mm: x * Number(step.value), y_mm: y * Number(step.value) }));
  const program = h('select', { id: 'live-program' });
  const motions = h('fieldset', { disabled: true }, h('legend', {}, 'Motion'),
    h('p', { class: 'bar' }, button('Home', { do: 'home' }), button('Tare', { do: 'tare' }), button('Clear the fault', { do: 'clear' }), button('Retreat from the load', { do: 'retreat' })),
    h('p', { class: 'bar' }, h('label', { for: 'live-step' }, 'Jog by '), step, jog('x \u2212', -1, 0), jog('x +', 1, 0), jog('y \u2212', 0, -1), jog('y +', 0, 1)),
    h('p', { class: 'bar' }, h('label', { for: 'live-program' }, 'Program '), program, button('Run', () => requestLive({ do: 'run', program: program.value }))));
  const [watch, updateWatch] = live.isOffered ? [null, () => {}] : watchSection();
  main().append(
    ...(watch ? [watch] : []),
    section('Device', h('table', {}, rows)),
    ...(watch ? [] : [section('Control', held, h('p', { class: 'bar' }, control), motions, progress, outcome)]),
    h('div', { class: 'panels' }, h('div', { class: 'panel' }, h('h3', {}, 'Force'), force), h('div', { class: 'panel' }, h('h3', {}, 'Position of guide 2'), position)),
    saveBar('live', () => ({ ...live.last, decoded: live.counts, trace: live.points })));
  let count = 0;
  let listed = '';
  const setText = (element, text) => { if (element.textContent !== text) element.textContent = text; };
  const setRows = (all) => rows.replaceChildren(...all.map(([name, text]) => h('tr', {}, h('th', { scope: 'row' }, name), h('td', {}, text))));
  const drawTraces = () => {
    count += 1;
    if (count % PLOT_EVERY !== 1) return;
    const draw = (into, title, unit, first) => plot(into, { title, x: 'time, s', y: unit, height: 220, xRange: [-KEPT_S, 0], series: [...traceOf(first, 'a', 'x'), ...traceOf(first + 1, 'b', 'y')] });
    draw(force, 'Force over the last half minute', 'force, N', 0);
    draw(position, 'Position of guide 2 over the last half minute', 'displacement, mm', 2);
  };
  live.draw = () => {
    if (watch) {
      updateWatch();
      setRows(watchedRows());
      drawTraces();
      return;
    }
    const { last } = live;
    motions.disabled = !hasControl();
    if (last === null) {
      setText(held, 'The program guide web does not answer.');
      control.disabled = true;
      return;
    }
    control.disabled = last.control === 'other';
    setText(control, last.control === 'this' ? 'Give up control' : 'Take control');
    setText(held, { none: 'No page has control.', this: 'This page has control: the device stops when the page is hidden, closed or does not answer.', other: 'Another page has control; this one shows what happens.' }[last.control]);
    setRows(liveRows(last, live.counts));
    setText(outcome, last.notice || (last.outcome ? last.outcome.text : ''));
    if (listed !== last.programs.join()) {
      listed = last.programs.join();
      program.replaceChildren(...last.programs.map((name) => h('option', { value: name }, name)));
    }
    progress.hidden = !(last.program && isMoving() && last.device.step !== null);
    if (!progress.hidden) { progress.max = last.program.steps; progress.value = last.device.step + 1; }
    drawTraces();
  };
  live.draw();
}
