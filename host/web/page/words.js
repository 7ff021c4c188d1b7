// Texts of the page: plain names of the effects, definitions of terms, and moduli for comparison.

/** A value of an effect's parameter, as a number of a diagnosis or of a slider. */
const valueOf = (parameters, name) => parameters?.[name]?.value ?? parameters?.[name];

/** Names of the effects. A name that depends on the values of the parameters is a function of them. */
const PLAIN = {
  'tissue.layers': (own) => (Number.isFinite(valueOf(own, 'k_ratio')) ? `a ${valueOf(own, 'k_ratio') > 1 ? 'stiffer' : 'softer'} layer below ${number(valueOf(own, 'boundary_mm'))} mm` : 'a layer of another stiffness'),
  'tissue.gradient': (own) => (valueOf(own, 'gradient_per_mm') < 0 ? 'tissue that becomes softer with depth' : 'tissue that becomes stiffer with depth'),
  'tissue.stiffening': 'tissue that stiffens when it is pushed far',
  'tissue.relaxation': 'tissue that relaxes while it is held',
  'tissue.shear': 'neighbouring tissue that is pulled along (shear)',
  'tissue.entry_gap': (own) => (Number.isFinite(valueOf(own, 'gap_mm')) ? `no contact down to ${number(valueOf(own, 'gap_mm'))} mm below the surface` : 'no contact with the tissue just below the surface'),
  'tissue.skin': 'a stiff skin',
  'tissue.anisotropy': 'tissue that is stiffer in one direction',
  'tissue.yield': 'tissue that gives way near the surface',
  'tissue.finite_body': 'walls of the sample',
  'rig.guide2_position': 'a position of guide 2 that differs from the stated one',
  'rig.surface_position': 'a tissue surface that is further from or nearer to guide 2 than stated',
  'rig.clamp_compliance': 'a guide 1 that lets the needle tilt',
  'rig.frame_compliance': 'a frame that bends under load',
  'rig.backlash': 'clearance of the needle in guide 2',
  'rig.play': 'play in the drive of guide 2',
  'rig.friction': 'friction in guide 2',
  'rig.rear_rotation': 'a clamp that lets the needle tilt, more in one plane',
  'sensor.force_bias': 'a force sensor whose zero is off',
  'sensor.force_gain': 'a force sensor that reads too much or too little',
  'sensor.force_drift': 'a force sensor that drifts',
  'sensor.crosstalk': 'crosstalk between the axes of the force sensor',
  'sensor.delay': 'force readings that come late',
  'sensor.shape_offset': 'a measured shape that is displaced',
  'sensor.shape_scale': 'a measured shape of the wrong scale',
  'sensor.depth_shift': 'a measured shape that is shifted along the needle',
  'imaging.sound_speed': 'another speed of sound than the scanner assumes',
  'imaging.lag': 'ultrasound frames that come late',
  'imaging.echo_offset': 'an echo beside the needle\u2019s axis',
  'needle.stiffness': 'a needle that is stiffer or softer than stated',
  'needle.prebend': 'a needle that is bent without any load',
  'needle.axial_load': 'a needle that is pushed along its axis',
  'tip.load_slope': 'a load on the tip that grows with depth',
  'tip.load_step': (own) => (Number.isFinite(valueOf(own, 'depth_mm')) ? `a load on the tip that jumps at ${number(valueOf(own, 'depth_mm'))} mm` : 'a load on the tip that jumps'),
  'tip.entry_angle': 'a needle that enters at an angle',
  'tip.bevel_roll': 'a bevel that is turned about the needle',
  'tip.rate': 'a load on the tip that grows with the speed',
  'tip.cut_angle': 'a tip that cuts at an angle',
};

/** The plain name of an effect, with its values if they are known. An effect of a file has no plain name: its id is used. */
function plainName(id, parameters = null) {
  const name = PLAIN[id] ?? id;
  return typeof name === 'function' ? name(parameters ?? {}) : name;
}

const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

const TERMS = {
  K: 'Foundation modulus: sideways force of the tissue per length of needle and per deflection. It depends on both needle and tissue.',
  E: 'Young\u2019s modulus: stiffness of the tissue alone, whatever the needle.',
  interval: 'If everything assumed holds, 95 of 100 such intervals contain the true value.',
  'chi-square per reading': 'Squared misfit over squared noise, on average. About 1: noise alone. 4: the misfit is twice the noise.',
  'log evidence': 'Logarithm of the probability that a model gives to all readings, compared with another model; adjustable parameters lower it. A difference of 2.3 is a factor of ten.',
  residual: 'Measured minus computed by the model.',
  'standard deviations': 'Residual in units of the noise of one reading. A value beyond 3 is rarely due to chance.',
  'held out': 'Runs that no fit has used. They show whether a model predicts new data.',
  'tip load': 'Sideways force of the tissue on the tip, for example on a bevel. It bends the path.',
  band: 'At each depth it contains the tip with a probability of 95 %, if everything assumed holds.',
  'plain model': 'A needle as a beam in tissue of one stiffness, without any effect.',
  effect: 'A piece of physics that can be added to the model, such as a second layer or friction.',
};

/** A term with its meaning on hover, on focus and for screen readers. */
const term = (name, shown = name) => h('dfn', { class: 'term', tabindex: '0', title: TERMS[name] }, shown);

/** Young's moduli for comparison, kPa; the manual has the sources. */
const TYPICAL = [
  ['spleen', '3'], ['fat and gland of the breast', '3'], ['healthy liver', '3 to 8'], ['kidney, pancreas', '5'],
  ['muscle at rest', '10'], ['prostate without cancer', '30'], ['prostate cancer', '60'], ['gels for phantoms', '2 to 50'],
];

function typicalValues() {
  return h('details', { id: 'typical' }, h('summary', {}, 'Typical values: Young\u2019s moduli of tissues and gels'),
    h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'Typical moduli' }, h('table', {}, h('thead', {}, h('tr', {}, ...['Tissue', 'E, kPa, about'].map((name) => h('th', { scope: 'col' }, name)))),
      h('tbody', {}, ...TYPICAL.map(([tissue, modulus]) => h('tr', {}, h('th', { scope: 'row' }, tissue), h('td', {}, modulus)))))),
    h('p', { class: 'note' }, 'Orders of magnitude of E; they differ by a factor of two between methods, strains and persons. K of an 18 gauge needle is about 0.9 times E if the tissue adheres to the needle. Sources: the manual, Identifying the modulus.'));
}

/** The model that a view uses, in words, followed by buttons. */
function modelLine(text, ...more) {
  return h('p', { class: 'model', 'data-model': text }, h('strong', {}, 'Model: '), text, ...more);
}

/** An effect of a diagnosis, and the other effects of its class. */
const explanations = (one) => [plainName(one.id, one.parameters), ...one.class.filter((id) => id !== one.id).map((id) => plainName(id))];

/** Effects and model of the diagnosis of this session; null if it has not been diagnosed. */
async function foundModel() {
  const key = JSON.stringify(['diagnose', {}]);
  if (!state.results.has(key)) return null;
  const { document: found, model } = await state.results.get(key);
  return { names: found.effects.map((one) => explanations(one).join(' or ')), model };
}
