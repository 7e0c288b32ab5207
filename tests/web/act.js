// Uses a page that a server of this machine gives out, in headless Chromium, as a person does. Reads JSON:
// {"url", "width", "height", "scheme", "steps": [{…}, …]}; writes {"values", "said", "clicks", "axe", "wide"}. A step is one of
//   {"click": "words"}        a click on what is visible under these words      {"press": "key"}
//   {"css": "selector"}       a click on what a selector names                  {"fill": ["selector", "text"]}
//   {"drop": ["path", …]}     files dropped on the page                         {"choose": ["selector", "value"]}
//   {"slide": ["selector", value]}  drags the handle of a slider there          {"type": ["selector", "text"]}  key by key
//   {"until": "expression"}   waits until it is true, at most 180 s             {"value": "expression"}  kept in "values"
//   {"axe": "name"}  {"wide": "name"}  {"picture": "path"}  {"size": [w, h]}  {"scheme": "dark"}
//   {"repeat": [n, [steps]]}  {"spent": true}   keeps [bytes on the heap after collection, seconds of script so far] in "values"
// `said` are messages of the console and errors; `requests` to other hosts are among them. `clicks` counts clicks and slides.
"use strict";
const fs = require("node:fs");
const path = require("node:path");
const { launch } = require("./browser.js");

const RULES = "axe.run({ runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa'] })";

async function until(page, expression, patience = 180000) {
  // Playwright's own waiting makes code from text inside the page, which the page's policy forbids.
  for (const end = Date.now() + patience; !(await page.evaluate(expression)); await page.waitForTimeout(50)) {
    if (Date.now() > end) throw new Error(`${expression} does not come true; the page says: ${await page.evaluate("document.body.innerText")}`);
  }
}

/** What is visible under some words: a button or link of that name, else the text itself. */
async function named(page, words) {
  for (const role of ["button", "link", "checkbox", "radio"]) {
    const found = page.getByRole(role, { name: words, exact: true });
    if (await found.count()) return found.first();
  }
  return page.getByText(words, { exact: true }).first();
}

async function drop(page, files) {
  const list = files.map((file) => ({ name: path.basename(file), base64: fs.readFileSync(file).toString("base64") }));
  const handle = await page.evaluateHandle((given) => {
    const transfer = new DataTransfer();
    for (const { name, base64 } of given) {
      const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
      transfer.items.add(new File([bytes], name));
    }
    return transfer;
  }, list);
  await page.dispatchEvent("body", "drop", { dataTransfer: handle });
}

async function slide(page, selector, value) {
  const slider = page.locator(selector).first();
  await slider.scrollIntoViewIfNeeded();
  const box = await slider.boundingBox();
  const [now, share] = await slider.evaluate((s, to) => [Number(s.value), to].map((v) => (v - Number(s.min)) / (Number(s.max) - Number(s.min))), value);
  // The handle's middle stays 11 px from both ends.
  const x = (part) => box.x + 11 + part * (box.width - 22);
  await page.mouse.move(x(now), box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(x((now + share) / 2), box.y + box.height / 2, { steps: 4 });
  await page.mouse.move(x(share), box.y + box.height / 2, { steps: 4 });
  await page.mouse.up();
}

(async () => {
  const asked = JSON.parse(fs.readFileSync(0, "utf8"));
  const browser = await launch();
  const context = await browser.newContext({
    viewport: { width: asked.width ?? 1400, height: asked.height ?? 900 }, colorScheme: asked.scheme ?? "light", reducedMotion: "reduce", acceptDownloads: true,
    bypassCSP: asked.steps.some((step) => step.axe),
  });
  const page = await context.newPage();
  // A machine that builds beside it takes longer than the usual 30 s for a click.
  page.setDefaultTimeout(180000);
  const out = { values: [], said: [], clicks: 0, axe: {}, wide: {} };
  const host = new URL(asked.url).host;
  page.on("console", (message) => {
    // A refusal of the server is no fault of the page: it is told in words.
    if (!/Failed to load resource: the server responded with a status of (4\d\d)/.test(message.text())) out.said.push(`${message.type()}: ${message.text()}`);
  });
  page.on("pageerror", (error) => out.said.push(`error: ${error.message}`));
  page.on("request", (request) => {
    const url = new URL(request.url());
    if (!["data:", "blob:"].includes(url.protocol) && url.host !== host) out.said.push(`request: ${request.url()}`);
  });
  await page.goto(asked.url);
  await until(page, "globalThis.Propwash?.lab?.ready === true");
  /** [bytes on the heap after collection, seconds of script so far] of the page. */
  let inside = null;
  async function spent() {
    if (!inside) {
      inside = await context.newCDPSession(page);
      await inside.send("Performance.enable");
    }
    for (let k = 0; k < 3; k++) await inside.send("HeapProfiler.collectGarbage");
    const { metrics } = await inside.send("Performance.getMetrics");
    return ["JSHeapUsedSize", "ScriptDuration"].map((name) => metrics.find((m) => m.name === name).value);
  }
  async function take(step) {
    const [kind] = Object.keys(step);
    const given = step[kind];
    try {
      if (kind === "repeat") {
        for (let k = 0; k < given[0]; k++) for (const one of given[1]) await take(one);
      } else if (kind === "spent") out.values.push(await spent());
      else if (kind === "click") {
        out.clicks++;
        await (await named(page, given)).click();
      } else if (kind === "css") {
        out.clicks++;
        await page.locator(given).first().click();
      } else if (kind === "slide") {
        out.clicks++;
        await slide(page, ...given);
      } else if (kind === "drop") await drop(page, given);
      else if (kind === "press") await page.keyboard.press(given);
      else if (kind === "fill") await page.locator(given[0]).first().fill(given[1]);
      else if (kind === "type") await page.locator(given[0]).first().pressSequentially(given[1], { delay: 30 });
      else if (kind === "choose") await page.locator(given[0]).first().selectOption(given[1]);
      else if (kind === "until") await until(page, given);
      else if (kind === "value") out.values.push(await page.evaluate(given));
      else if (kind === "size") await page.setViewportSize({ width: given[0], height: given[1] });
      else if (kind === "scheme") await page.emulateMedia({ colorScheme: given });
      else if (kind === "picture") await page.screenshot({ path: given, fullPage: Boolean(step.whole) });
      else if (kind === "wide") out.wide[given] = await page.evaluate("document.documentElement.scrollWidth");
      else if (kind === "axe") {
        await page.evaluate(fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8"));
        const result = await page.evaluate(RULES);
        out.axe[given] = result.violations.map((v) => `${v.id}: ${v.nodes.map((n) => n.target).join(", ")}`);
      } else throw new Error(`no such step: ${kind}`);
    } catch (error) {
      if (process.env.PROPWASH_FAULT) await page.screenshot({ path: process.env.PROPWASH_FAULT });
      throw new Error(`${JSON.stringify(step)}: ${error.message}\nthe page says: ${(await page.evaluate("document.body.innerText")).slice(0, 3000)}\n${out.said.join("\n")}`);
    }
  }
  for (const step of asked.steps) await take(step);
  await browser.close();
  process.stdout.write(JSON.stringify(out));
})();
