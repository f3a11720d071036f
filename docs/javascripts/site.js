// Wide tables scroll inside a frame that the theme puts around them; a keyboard has to reach it.
document$.subscribe(() => {
  requestAnimationFrame(() => {
    for (const frame of document.querySelectorAll(".md-typeset__scrollwrap")) {
      if (frame.scrollWidth > frame.clientWidth) {
        frame.tabIndex = 0;
        frame.setAttribute("role", "region");
        frame.setAttribute("aria-label", "Table");
      }
    }
  });
});
