// Takes pictures of the page of a report while its first effect is turned on: the frames of README's animation.
// Arguments: the page (HTML), a folder for frames (PNG), frames per second.
"use strict";
const { pathToFileURL } = require("node:url");
const path = require("node:path");
const { launch } = require("../tests/web/browser.js");

const SIZE = { width: 1060, height: 800 };
/** Seconds of flight before the switch, of the slider from zero to its estimate, and after. */
const [BEFORE_S, SLIDE_S, AFTER_S] = [3, 2.5, 2.5];

/** Moves a control of the page as a hand would. */
async function set(input, value) {
  await input.evaluate((element, v) => {
    element.value = String(v);
    element.dispatchEvent(new Event("input", { bubbles: true }));
  }, value);
}

async function film(page, folder, rate) {
  // What is beside the subject is left out of the picture, and the flight stands beside its effect.
  await page.addStyleTag({ content: "details, nav, #redrawn, #lab .buttons button + button { display: none !important } body { overflow: hidden }" });
  const lab = page.locator("#lab");
  await lab.evaluate((element) => window.scrollTo(0, element.getBoundingClientRect().top + window.scrollY - 8));
  const box = await lab.boundingBox();
  const clip = { x: Math.max(box.x - 16, 0), y: 0, width: Math.min(box.width + 32, SIZE.width), height: SIZE.height };
  // Two of the plots below stand beside the flight here.
  await page.evaluate(() => {
    const plots = [...document.querySelectorAll("figure")].filter((f) => /^force along body [xy]/.test(f.textContent));
    document.getElementById("effects").append(...plots.slice(0, 2));
    window.dispatchEvent(new Event("resize"));
  });
  await page.waitForTimeout(300);
  const time = page.locator("#lab input[aria-label=time]");
  const [effect] = await page.locator("#lab .effect").all();
  const slider = effect.locator("input[type=range]").first();
  const [estimate, worst, end] = [Number(await slider.inputValue()), Number(await time.inputValue()), Number(await time.getAttribute("max"))];
  const length = BEFORE_S + SLIDE_S + AFTER_S;
  const from = Math.min(Math.max(worst - BEFORE_S + 0.5, 0), end - length);
  for (let k = 0; k < length * rate; k++) {
    const at = k / rate;
    await set(time, from + at);
    const share = Math.min(Math.max((at - BEFORE_S) / SLIDE_S, 0), 1);
    // Slow at both ends, as a hand is.
    if (share > 0) await set(slider, estimate * share * share * (3 - 2 * share));
    await page.waitForTimeout(60);
    await page.screenshot({ path: path.join(folder, `${String(k).padStart(4, "0")}.png`), clip });
  }
}

(async () => {
  const [html, folder, rate] = process.argv.slice(2);
  const browser = await launch();
  const page = await browser.newPage({ viewport: SIZE, colorScheme: "light", bypassCSP: true });
  await page.goto(pathToFileURL(html).href);
  await page.waitForFunction(() => globalThis.Propwash?.scene, undefined, { timeout: 60000 });
  await film(page, folder, Number(rate));
  await browser.close();
})().catch((error) => {
  process.stderr.write(`${error.message}\n`);
  process.exitCode = 1;
});
