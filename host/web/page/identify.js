// Identify: the modulus of the tissue by every method, with intervals, and the residuals of the fit.

/** A dot with its interval on a common axis, for a column of estimates. */
function whisker(low, value, high, [least, most]) {
  if (![value].every(Number.isFinite)) return '';
  const at = (x) => Math.max(0, Math.min(100, (100 * (x - least)) / (most - least)));
  return h('svg:svg', { class: 'whisker', viewBox: '0 0 100 10', preserveAspectRatio: 'none', 'aria-hidden': 'true' },
    h('svg:line', { x1: at(low), x2: at(high), y1: 5, y2: 5 }), h('svg:line', { x1: at(value), x2: at(value), y1: 1, y2: 9, class: 'dot' }));
}

/** Whether the runs disagree beyond their noise, as where the program widens the pooled interval (theory, eq. 28). */
const disagree = ({ pooled }) => (pooled.heterogeneity?.p ?? 1) < 0.05;

function showIdentify() {
  within('identify', async (isHere) => {
    // K does not depend on relation and foundation; with the quickest ones it is shown at once.
    const { document: found, figures } = await result('identify', { relation: 'vesic', foundation: 'springs' }, 'Identifying the modulus');
    if (!isHere()) return;
    const { pooled } = found;
    const methods = [['likelihood', 'Beam, all sensors'], ['likelihood_without_force', 'Beam without force'], ['energy', 'Energy balance'], ['energy_as_printed', 'Energy, as published']];
    const ends = found.runs.flatMap((run) => methods.flatMap(([name]) => [run.methods[name].k_kpa, ...(run.methods[name].ci95_kpa || [])])).filter(Number.isFinite);
    const axis = rangeOf([ends.concat(pooled.ci95_kpa)]);
    const cell = (one) => (one.k_kpa === null ? h('td', {}, '-') : h('td', {},
      h('strong', {}, number(one.k_kpa)), one.ci95_kpa ? ` (${interval(one.ci95_kpa)})` : '',
      one.ci95_kpa ? whisker(one.ci95_kpa[0], one.k_kpa, one.ci95_kpa[1], axis) : ''));
    const rows = found.runs.map((run) => h('tr', {}, h('th', { scope: 'row' }, run.id), h('td', {}, `${number(run.depth_mm)}\u00a0mm`),
      ...(run.error || run.left_out ? [h('td', { colspan: methods.length }, `skipped: ${run.error || run.left_out}`)] : methods.map(([name]) => cell(run.methods[name])))));
    const youngs = h('p', { id: 'youngs', 'aria-live': 'polite' }, 'Young\u2019s modulus E is being computed for this needle and rig ...');
    const kept = h('div', {});
    const notes = h('div', {});
    const note = ({ warnings, runs }) => {
      const remarks = [...warnings, ...runs.flatMap((run) => run.warnings.map((text) => `${run.id}: ${text}`))];
      notes.replaceChildren(...(remarks.length ? [h('h3', {}, `Notes: ${remarks.length}`), h('ul', {}, ...remarks.map((text) => h('li', {}, text)))] : []));
    };
    const isDoubtful = disagree(found);
    const made = h('div', { class: 'figures' });
    const ids = [...new Set(figures.map((one) => one.name.replace(/\.[a-z]+$/, '')))];
    const pick = h('select', { id: 'identify-run', onchange: () => draw() }, ...ids.map((id) => h('option', { value: id }, id)));
    const draw = () => made.replaceChildren(...figures.filter((one) => one.name.startsWith(`${pick.value}.`)).map(figure));
    main().append(
      h('section', { class: 'lead' }, h('h2', {}, 'Foundation modulus ', term('K')),
        isDoubtful ? h('p', { class: 'deciding', id: 'deciding', role: 'note' }, h('strong', {}, 'The runs disagree: '), 'one modulus does not describe this tissue. The value below is an average; perhaps no part of the tissue has this modulus. ',
          h('button', { type: 'button', class: 'primary', onclick: () => show('diagnose') }, 'Diagnose what the model lacks')) : null,
        h('p', { class: 'readout' }, h('span', { class: isDoubtful ? 'big doubtful' : 'big', id: 'pooled-k', 'data-k': pooled.k_kpa }, `${number(pooled.k_kpa, 4)} kPa`), ' 95 % ', term('interval'), ` ${interval(pooled.ci95_kpa, 4)} kPa, from ${pooled.runs} ${pooled.runs === 1 ? 'run' : 'runs'}`),
        modelLine('plain: a needle as a beam in tissue of one stiffness, no effect'),
        youngs, typicalValues(),
        isDoubtful ? null : h('p', { class: 'bar' }, h('button', { type: 'button', class: 'primary', onclick: () => show('diagnose') }, 'Diagnose what the model lacks'))),
      section('By run and method, kPa', h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'Modulus by run and method' }, h('table', {}, h('thead', {}, h('tr', {},
        ...['Run', 'Depth', ...methods.map(([, name]) => name)].map((name) => h('th', { scope: 'col' }, name)))), h('tbody', {}, ...rows))),
      notes),
      section('Shape and residuals', h('p', {}, h('label', { for: 'identify-run' }, 'Run '), pick), made), kept);
    draw();
    note(found);
    const { document: whole } = await result('identify', {}, 'Young\u2019s modulus');
    if (!isHere()) return;
    note(whole);
    const of = whole.youngs_modulus_kpa;
    youngs.textContent = of && Number.isFinite(of.value)
      ? `Young\u2019s modulus E ${number(of.value)} kPa (${interval(of.ci95)}), by ${of.relation}${whole.walls.stated === 'not_stated' ? ', walls of the tissue not stated: E may be wrong by half or more' : ''}; ${interval(of.range_kpa)} kPa over all relations`
      : `Young\u2019s modulus E: ${of?.refused ?? 'not identifiable from these runs'}`;
    kept.replaceChildren(saveBar('identify', () => whole));
  });
}
