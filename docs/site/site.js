// What readers of screens and keyboards need beyond the theme: names of landmarks that differ, and focus for what scrolls sideways.
document$.subscribe(() => {
  const seen = new Map();
  for (const nav of document.querySelectorAll("nav")) {
    const by = nav.getAttribute("aria-labelledby");
    const named = by && document.getElementById(by);
    const name = (nav.getAttribute("aria-label") || (named && named.textContent.trim()) || "Code").replace(/\s+/g, " ");
    const count = (seen.get(name) || 0) + 1;
    seen.set(name, count);
    nav.removeAttribute("aria-labelledby");
    nav.setAttribute("aria-label", count > 1 ? `${name}, ${count}` : name);
  }
  for (const part of document.querySelectorAll("pre > code, math[display=block], .md-typeset__table")) {
    part.tabIndex = 0;
  }
});
