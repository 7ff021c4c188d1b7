// Figures of the manual that have a view of guide.html: where the page lies beside the manual, the view takes the place of the picture.
// Without scripts, or without the page, the picture stays.

(() => {
  const root = typeof path_to_root === 'string' ? path_to_root : '';
  const figures = document.querySelectorAll('[data-view]');

  function begin(figure) {
    const frame = document.createElement('iframe');
    frame.title = figure.dataset.title;
    frame.src = `${root}guide.html#${figure.dataset.view}&embed=yes`;
    // Not hidden: what is hidden is not drawn. It takes no room until there is something to see.
    Object.assign(frame.style, { width: '100%', height: '0', border: '0', display: 'block' });
    window.addEventListener('message', (event) => {
      if (event.source !== frame.contentWindow || event.data?.guide !== 'shown' || !(event.data.height > 0)) return;
      frame.style.height = `${Math.min(event.data.height, 5000)}px`;
      [...figure.children].forEach((child) => { child.hidden = child !== frame; });
    });
    figure.append(frame);
  }

  // Only what a reader comes to is loaded.
  const observer = new IntersectionObserver((entries) => entries.filter((entry) => entry.isIntersecting).forEach(({ target }) => {
    observer.unobserve(target);
    begin(target);
  }));
  figures.forEach((figure) => observer.observe(figure));
})();
