// @ts-check
"use strict";
// Loads the page again when its scene was saved, with the camera where it is.
(() => {
  const P = globalThis.Propwash;
  const seen = document.querySelector("meta[name='propwash-version']")?.getAttribute("content") ?? "0";
  async function wait() {
    for (;;) {
      let version = seen;
      try {
        version = (await (await fetch(`/version?seen=${seen}`)).text()).trim();
      } catch {
        // The program has ended, or begins anew: it is asked again.
        await new Promise((done) => setTimeout(done, 2000));
      }
      if (version === seen) continue;
      const camera = P.shown?.view.cameraText();
      if (camera) location.hash = new URLSearchParams({ cam: camera }).toString();
      location.reload();
      return;
    }
  }
  wait();
})();
