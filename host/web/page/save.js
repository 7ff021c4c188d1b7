// Saves a view as files: its document, its pictures as one, and the view itself as a page without scripts.

/** Properties of the style sheet that a picture needs when it stands alone; SVG has attributes of these names. */
const DRAWN = ['fill', 'fill-opacity', 'stroke', 'stroke-width', 'stroke-dasharray', 'stroke-linecap', 'stroke-linejoin', 'opacity', 'font-family', 'font-size', 'font-weight', 'text-anchor'];
/** Pixels between pictures, and of the line with a picture's title. */
const BETWEEN = 14;
const TITLE = 22;
/** Pixels of a saved bitmap per pixel of the screen. */
const SHARPNESS = 2;

function saveFile(name, content, type) {
  const url = URL.createObjectURL(new Blob([content], { type }));
  h('a', { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}

/** A copy of a drawn SVG that looks the same without the style sheet. */
function standalone(drawn) {
  const copy = drawn.cloneNode(true);
  const originals = [drawn, ...drawn.querySelectorAll('*')];
  [copy, ...copy.querySelectorAll('*')].forEach((element, i) => {
    const style = getComputedStyle(originals[i]);
    // A line width that does not scale with the picture is in pixels of the screen.
    if (style.vectorEffect !== 'none') element.setAttribute('vector-effect', style.vectorEffect);
    DRAWN.forEach((property) => {
      const value = style.getPropertyValue(property);
      if (value) element.setAttribute(property, value.replaceAll('"', "'"));
    });
    element.removeAttribute('class');
  });
  return copy;
}

/** The visible pictures of the view, arranged as on the screen; null if there is none. */
function pictureOf(root) {
  const shown = [...root.querySelectorAll('svg[role="img"]')].map((drawn) => [drawn, drawn.getBoundingClientRect()]).filter(([, box]) => box.width > 0 && box.height > 0);
  if (shown.length === 0) return null;
  const whole = h('svg:svg', { xmlns: SVG });
  const style = getComputedStyle(document.body);
  const paper = h('svg:rect', { width: '100%', height: '100%', fill: style.backgroundColor });
  whole.append(paper);
  let [x, y, tall, widest, top] = [BETWEEN, BETWEEN, 0, 0, null];
  for (const [drawn, box] of shown) {
    if (top !== null && Math.abs(box.top - top) > 4) { y += tall + BETWEEN; [x, tall] = [BETWEEN, 0]; }
    top = box.top;
    const title = h('svg:text', { x, y: y + 14, fill: style.color, 'font-family': 'sans-serif', 'font-size': 13 }, drawn.getAttribute('aria-label') ?? '');
    const copy = standalone(drawn);
    Object.entries({ x, y: y + TITLE, width: box.width, height: box.height }).forEach(([name, value]) => copy.setAttribute(name, value));
    // A title never runs into the picture beside it.
    const clip = h('svg:svg', { x: 0, y: 0, width: x + box.width, height: y + TITLE }, title);
    whole.append(clip, copy);
    x += box.width + BETWEEN;
    tall = Math.max(tall, box.height + TITLE);
    widest = Math.max(widest, x);
  }
  const [width, height] = [Math.ceil(widest), Math.ceil(y + tall + BETWEEN)];
  Object.entries({ width, height, viewBox: `0 0 ${width} ${height}` }).forEach(([name, value]) => whole.setAttribute(name, value));
  return { text: `<?xml version="1.0" encoding="UTF-8"?>\n${new XMLSerializer().serializeToString(whole)}\n`, width, height };
}

/** A picture as PNG. */
async function bitmapOf({ text, width, height }) {
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  await image.decode();
  // A canvas has a limit: a tall picture is drawn less sharply.
  const scale = Math.min(SHARPNESS, 16000 / height, 16000 / width);
  const canvas = h('canvas', { width: Math.round(scale * width), height: Math.round(scale * height) });
  canvas.getContext('2d').drawImage(image, 0, 0, canvas.width, canvas.height);
  return new Promise((resolve, reject) => canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error('the picture is too large for this browser, expected a smaller view'))), 'image/png'));
}

/** The text that replaces a control in a page without scripts. */
function asText(control) {
  if (control.tagName === 'SELECT') return control.selectedOptions[0]?.textContent ?? '';
  if (control.type === 'checkbox') return control.checked ? '\u2611 ' : '\u2610 ';
  return '';
}

/** The view as a page: everything it shows, nothing to operate, no scripts. */
function pageOf(root, name) {
  const copy = root.cloneNode(true);
  const controls = [...root.querySelectorAll('select, input')];
  [...copy.querySelectorAll('select, input')].forEach((control, i) => control.replaceWith(asText(controls[i])));
  copy.querySelectorAll('button, .bar, .save').forEach((element) => element.remove());
  copy.querySelectorAll('details').forEach((details) => details.setAttribute('open', ''));
  copy.querySelectorAll('[tabindex]').forEach((element) => element.removeAttribute('tabindex'));
  const title = `${state.session ? `${state.session}: ` : ''}${name}`;
  const made = `Made by ${document.querySelector('meta[name="generator"]').content}, ${new Date().toISOString().slice(0, 10)}, in a browser. Research software, not a medical device.`;
  const head = h('head', {}, h('meta', { charset: 'utf-8' }), h('meta', { 'http-equiv': 'Content-Security-Policy', content: "default-src 'none'; style-src 'unsafe-inline'" }),
    h('meta', { name: 'viewport', content: 'width=device-width, initial-scale=1' }), h('meta', { name: 'color-scheme', content: 'light dark' }), h('title', {}, title));
  // The text of a style element is a text in HTML, not markup.
  const style = `<style>${document.querySelector('style').textContent}</style>`;
  const body = h('body', {}, h('header', {}, h('h1', {}, title)), copy, h('footer', {}, h('p', {}, made)));
  return `<!doctype html>\n<html lang="en">\n${head.outerHTML.replace('</head>', `${style}</head>`)}\n${body.outerHTML}\n</html>\n`;
}

/** Buttons that save the view: `content` gives the document that it shows. */
function saveBar(name, content) {
  const base = () => `${state.session ? `${state.session}.` : ''}${name}`;
  const button = (label, run) => h('button', { type: 'button', 'data-save': label, onclick: async () => {
    try {
      await run();
    } catch (error) {
      fail(error);
    }
  } }, `Save ${label}`);
  const picture = () => {
    const found = pictureOf(main());
    if (!found) throw new Error('this view shows no picture at the moment');
    return found;
  };
  return h('p', { class: 'bar save' },
    button('JSON', () => saveFile(`${base()}.json`, `${JSON.stringify(content(), null, 2)}\n`, 'application/json')),
    button('SVG', () => saveFile(`${base()}.svg`, picture().text, 'image/svg+xml')),
    button('PNG', async () => saveFile(`${base()}.png`, await bitmapOf(picture()), 'image/png')),
    button('page', () => saveFile(`${base()}.html`, pageOf(main(), name), 'text/html')));
}
