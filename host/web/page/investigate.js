// Investigation: the probabilities of the explanations from run to run, and why each run was chosen.

const ENDS = {
  named: 'It ended because the missing effect was named.',
  nothing_missing: 'It ended because no effect is missing, and no further run of this rig is expected to show one.',
  nothing_would_tell: 'It ended because an effect is missing, and no further run of this rig is expected to identify it.',
  modulus_known: 'It ended because the modulus is known with the requested accuracy.',
  max_runs: 'It ended because the allowed number of runs was reached.',
  stopped: 'It was stopped on request, and can be continued from there.',
};
/** Styles of the explanations that are drawn; the plain model has a style of its own. */
const STYLES = ['a', 'b', 'c'];

const explanationName = (effects) => (effects.length === 0 ? 'nothing missing' : effects.map((id) => plainName(id)).join(' and '));

/** The investigation of a session by its log; null without one. */
function investigationSection(log) {
  if (log === null || log.steps.length === 0) return null;
  const drawn = h('div', { class: 'drawn', id: 'investigation-drawn' });
  const made = section('Investigation: what was known after each run',
    h('p', { class: 'note' }, 'Probability of each explanation after the runs so far, as recorded by guide investigate. ', ENDS[log.end] ?? 'It has not ended.'),
    drawn, investigationTable(log.steps));
  made.id = 'investigation';
  responsive(drawn, () => drawProbabilities(drawn, log.steps));
  return made;
}

/** Probabilities over the number of runs: of no missing effect, and of the explanations that were likeliest at any step. */
function drawProbabilities(into, steps) {
  const runs = steps.map((one) => one.runs);
  const key = (effects) => effects.join(' ');
  const most = new Map();
  steps.forEach((step) => step.explanations.forEach(({ effects, probability }) => {
    const known = most.get(key(effects));
    if (!known || known.probability < probability) most.set(key(effects), { effects, probability });
  }));
  const probabilities = (effects) => steps.map((step) => 100 * (step.explanations.find((one) => key(one.effects) === key(effects))?.probability ?? 0));
  const missing = [...most.values()].filter(({ effects }) => effects.length > 0).sort((one, other) => other.probability - one.probability);
  const shown = [...(most.has('') ? [{ effects: [], style: 'plain' }] : []), ...missing.slice(0, STYLES.length).map(({ effects }, place) => ({ effects, style: STYLES[place] }))];
  const series = shown.flatMap(({ effects, style }) => {
    const y = probabilities(effects);
    return [{ kind: 'line', x: runs, y, style, label: explanationName(effects) }, { kind: 'dots', x: runs, y, style }];
  });
  plot(into, { title: 'Probability of the explanations over the runs', x: 'runs', y: 'probability, %', height: 260, xRange: [Math.min(...runs) - 0.25, Math.max(...runs) + 0.25], yRange: [0, 103], series });
}

/** Every step: its result, the run chosen next with the reason, and the information expected and gained from that run. */
function investigationTable(steps) {
  const row = (step, place) => {
    const [likeliest] = [...step.explanations].sort((one, other) => other.probability - one.probability);
    const told = steps[place + 1]?.realised_nats;
    const reasons = step.next ? step.next.reasons.map((id) => plainName(id)).join(', ') : '';
    return h('tr', {}, h('th', { scope: 'row' }, `${step.runs}`),
      h('td', {}, likeliest ? `${capital(explanationName(likeliest.effects))}, ${number(100 * likeliest.probability, 3)} %` : '-'),
      h('td', {}, `${number(100 * step.unseen_probability, 2)} %`),
      h('td', {}, `${number(step.k_kpa)} (${interval(step.k_ci95_kpa)})`),
      h('td', {}, step.next ? capital(step.next.what) : '-'), h('td', {}, reasons || '-'),
      h('td', {}, step.next ? number(step.next.information_nats, 2) : '-'), h('td', {}, number(told, 2)));
  };
  return h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'Steps of the investigation' }, h('table', {},
    h('thead', {}, h('tr', {}, ...['Runs', 'Likeliest', 'One more effect, not seen so far', 'K, kPa', 'Next run', 'Tells most about', 'Information expected, nats', 'Information gained, nats'].map((name) => h('th', { scope: 'col' }, name)))),
    h('tbody', {}, ...steps.map(row))));
}
