// The views Start and Session.

/** Picture of the rig with the measured quantities. */
function startPicture() {
  const text = (x, y, words) => h('svg:text', { x, y }, words);
  const rect = (x, y, width, height, style) => h('svg:rect', { x, y, width, height, rx: 4, style });
  return h('svg:svg', { viewBox: '0 0 900 250', class: 'picture', role: 'img', 'aria-label': 'A needle goes through two guides into soft tissue; guide 1 is fixed, guide 2 pushes the needle sideways and bends it; force, displacement, shape and tip are measured' },
    rect(390, 30, 490, 190, 'fill: var(--tissue)'),
    h('svg:line', { x1: 560, x2: 560, y1: 30, y2: 220, style: 'stroke: var(--soft); stroke-dasharray: 6 5' }),
    h('svg:line', { x1: 30, x2: 870, y1: 140, y2: 140, style: 'stroke: var(--line); stroke-dasharray: 3 5' }),
    rect(85, 156, 30, 64, 'fill: var(--line)'), rect(316, 124, 26, 96, 'fill: var(--line)'),
    h('svg:path', { d: 'M30 140H100C190 140 260 106 329 96C405 90 480 116 550 130C640 148 720 150 800 172', style: 'fill: none; stroke: var(--a); stroke-width: 6; stroke-linecap: round' }),
    rect(78, 124, 44, 32, 'fill: var(--soft)'), rect(307, 80, 44, 32, 'fill: var(--soft)'),
    h('svg:path', { d: 'M286 140V104m-7 9l7 -9l7 9', style: 'fill: none; stroke: var(--b); stroke-width: 3' }),
    text(60, 240, 'guide 1, fixed'), text(262, 240, 'guide 2, pushed by 1 mm'), text(170, 88, 'force, displacement'),
    text(410, 210, 'softer layer'), text(740, 210, 'stiffer layer'), text(600, 60, 'shape of the needle: ultrasound'), text(796, 160, 'tip'));
}

function showStart() {
  const choose = (attributes, label) => {
    const input = h('input', { type: 'file', ...attributes, class: 'hidden', tabindex: '-1', 'aria-hidden': 'true',
      onchange: () => { if (input.files.length) openChosen([...input.files].map((file) => [file.webkitRelativePath || file.name, file])); } });
    return h('span', {}, h('button', { type: 'button', onclick: () => input.click() }, label), input);
  };
  main().append(
    h('section', { class: 'lead' },
      h('h2', {}, 'How stiff is the tissue, where will the needle go, and what does the model miss?'),
      startPicture(),
      h('p', {}, 'A guide pushes a needle sideways in tissue. From the force, the needle\u2019s shape and the path of its tip this page computes how stiff the tissue is and where the tip goes next, and names what its model of needle and tissue lacks.')),
    h('div', { class: 'cards' },
      isServed() ? servedCard() : null,
      h('section', { class: 'card' }, h('h2', {}, 'Open the example'),
        h('p', {}, 'Simulated measurements in a tissue that the simplest model does not describe. Find out why.'),
        h('button', { type: 'button', class: 'primary', id: 'open-example', onclick: () => openExample('identify') }, 'Open the example')),
      h('section', { class: 'card' }, h('h2', {}, 'Play'),
        h('p', {}, 'Displace a needle, and see how force and shape change.'),
        h('button', { type: 'button', onclick: () => show('play') }, 'Play with a needle')),
      h('section', { class: 'card' }, h('h2', {}, 'Plan'),
        h('p', {}, 'The accuracy of a measurement, before it is made.'),
        h('button', { type: 'button', onclick: () => show('plan') }, 'Plan a run')),
      h('section', { class: 'card' }, h('h2', {}, 'Many sessions'),
        h('p', {}, 'Compare the sessions of many subjects, rigs and needles.'),
        h('button', { type: 'button', onclick: () => show('population') }, 'Compare sessions')),
      canWatch() ? h('section', { class: 'card' }, h('h2', {}, 'Watch a device'),
        h('p', {}, 'Force and position live, from a serial port of this computer.'),
        h('button', { type: 'button', onclick: () => show('live') }, 'Watch a device')) : null,
      h('section', { class: 'card', id: 'drop' }, h('h2', {}, 'Your session'),
        h('p', {}, 'Drop a session folder, its zip file, or tables of force and displacement from your own rig anywhere on this page; or choose them here. The data stay on this machine.'),
        h('p', { class: 'bar' }, choose({ webkitdirectory: true }, 'Choose a folder'), choose({ accept: '.zip' }, 'Choose a zip file'), choose({ multiple: true }, 'Choose tables')))));
}

function showSession() {
  within('session', async (isHere) => {
    const { document: check } = await result('check', {}, 'Checking the session');
    if (!isHere()) return;
    const findings = check.findings.map((one) => h('li', { class: one.severity.toLowerCase() },
      h('strong', {}, one.severity.toLowerCase() === 'error' ? 'Error ' : 'Warning '),
      h('code', {}, [one.file, one.line, one.column].filter((part) => part !== null && part !== '').join(':')), ' ',
      one.what, one.expected ? `; expected ${one.expected}` : ''));
    const able = check.abilities.map((one) => h('tr', {}, h('th', { scope: 'row' }, one.command),
      h('td', {}, one.usable ? 'yes' : 'no'), h('td', {}, one.runs.join(', ') || '-'),
      h('td', {}, [...one.skipped.map((skip) => `${skip.id ? `${skip.id}: ` : ''}${skip.reason}`), ...one.remarks].join('; ') || '-')));
    main().append(section('Check',
      findings.length ? h('ul', { class: 'findings' }, ...findings) : h('p', {}, 'No errors, no warnings.'),
      h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'What each command can use' }, h('table', {}, h('thead', {}, h('tr', {}, ...['Command', 'Usable', 'Runs', 'Remarks'].map((name) => h('th', { scope: 'col' }, name)))), h('tbody', {}, ...able)))));
    const session = await result('session', {}, 'Reading the runs');
    if (!isHere()) return;
    const boxes = [];
    const add = (title, settings) => {
      const into = h('div', { class: 'drawn' });
      boxes.push([h('div', { class: 'panel' }, h('h3', {}, title), into), into, settings]);
    };
    session.lateral.forEach((run) => {
      const dots = (kind, x, y, style) => [{ kind, x, y, style }];
      add(`${run.id}: force, at ${number(run.depth_mm)} mm`, { x: 'displacement of guide 2, mm', y: 'force, N', series: dots('dots', run.displacement_y_mm, run.force_y_n, 'a') });
      add(`${run.id}: displacement over time`, { x: 'time, s', y: 'displacement, mm', series: dots('line', run.time_s, run.displacement_y_mm, 'a') });
      if (run.shape_z_mm.length) add(`${run.id}: shape`, { x: 'position along the needle, mm', y: 'deflection, mm', series: dots('dots', run.shape_z_mm, run.shape_y_mm, 'b') });
    });
    session.insertion.forEach((run) => add(`${run.id}: path of the tip`, { x: 'insertion depth, mm', y: 'tip, mm',
      series: [{ kind: 'line', x: run.depth_mm, y: run.tip_y_mm, style: 'a', label: 'vertical' },
        ...(run.tip_x_mm ? [{ kind: 'line', x: run.depth_mm, y: run.tip_x_mm, style: 'b', label: 'horizontal' }] : [])] }));
    main().append(section('Runs', h('div', { class: 'panels' }, ...boxes.map(([box]) => box))), saveBar('check', () => check));
    boxes.forEach(([box, into, settings]) => responsive(into, () => plot(into, { title: box.firstChild.textContent, height: 200, ...settings })));
  });
}
