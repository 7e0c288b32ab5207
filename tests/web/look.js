// Opens pages from file:// without a network, or from a server of this machine ("address"), in headless Chromium and says what they show.
// Reads a list of looks as JSON: [{"page" | "address", "width", "height", "scheme", "hash", "steps": ["expression", …], "axe", "picture"}]; writes [{"values", "said", "wide", "axe"}].
// An expression is one of the page; a promise is waited for. `said` are messages of the console and errors; `wide` is the page's width.
"use strict";
const fs = require("node:fs");
const { pathToFileURL } = require("node:url");
const { launch } = require("./browser.js");

async function look(browser, asked) {
  const page = await browser.newPage({
    viewport: { width: asked.width ?? 1400, height: asked.height ?? 900 }, colorScheme: asked.scheme ?? "light", reducedMotion: "reduce", bypassCSP: Boolean(asked.axe),
  });
  await page.context().setOffline(!asked.address);
  const said = [];
  page.on("console", (message) => said.push(`${message.type()}: ${message.text()}`));
  page.on("pageerror", (error) => said.push(`error: ${error.message}`));
  page.on("request", (request) => /^(file|data|blob):/.test(request.url()) || (asked.address && request.url().startsWith(asked.address)) || said.push(`request: ${request.url()}`));
  const url = asked.address ? new URL(asked.address) : pathToFileURL(asked.page);
  url.hash = asked.hash ?? "";
  await page.goto(url.href);
  // Playwright's own waiting makes code from text inside the page, which the page's policy forbids.
  for (let tries = 0; asked.ready && !(await page.evaluate(asked.ready)); tries++) {
    if (tries > 600) throw new Error(`${asked.page}: ${asked.ready} does not come true; ${said.join("; ")}`);
    await page.waitForTimeout(50);
  }
  const values = [];
  for (const step of asked.steps ?? []) values.push(await page.evaluate(step));
  const wide = await page.evaluate("document.documentElement.scrollWidth");
  let found;
  if (asked.axe) {
    await page.evaluate(fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8"));
    const result = await page.evaluate("axe.run({ runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa'] })");
    found = result.violations.map((v) => `${v.id}: ${v.nodes.map((n) => n.target).join(", ")}`);
  }
  if (asked.picture) await page.screenshot({ path: asked.picture });
  await page.close();
  return { values, said, wide, axe: found };
}

(async () => {
  const asked = JSON.parse(fs.readFileSync(0, "utf8"));
  const browser = await launch();
  const out = [];
  for (const one of asked) out.push(await look(browser, one));
  await browser.close();
  process.stdout.write(JSON.stringify(out));
})();
