// @ts-check
"use strict";
// What the page asks the lab's server, and what it is told by it. One session at a time; its number outlives a reload of the page.
(() => {
  const P = (globalThis.Propwash ??= {});

  /** What the server refused, in words; `data` may hold something to work with. */
  class Refusal extends Error {
    /** @param {string} words @param {any} data @param {number} status */
    constructor(words, data, status) {
      super(words);
      this.data = data;
      this.status = status;
    }
  }

  const lab = (P.lab = {
    /** What the start page offers. @type {any} */
    start: null,
    /** Number of the session. @type {string | null} */
    id: sessionStorage.getItem("propwash session"),
    /** All that the server says of the session. @type {any} */
    state: null,
    /** @type {((state: any) => void)[]} */
    followers: [],
    /** @type {((news: any) => void)[]} */
    listeners: [],
    /** @type {EventSource | null} */
    source: null,
    Refusal,
  });

  /** @param {string} method @param {string} path @param {any} [body] @param {Record<string, string>} [headers] @returns {Promise<any>} */
  async function call(method, path, body, headers) {
    let response;
    try {
      response = await fetch(path, { method, body, headers, credentials: "same-origin", cache: "no-store" });
    } catch {
      throw new Refusal("the lab does not answer: look whether `propwash lab` still runs in its terminal, and start it again if not", {}, 0);
    }
    const kind = response.headers.get("content-type") ?? "";
    if (kind.startsWith("application/octet-stream")) return response.arrayBuffer();
    const data = kind.startsWith("application/json") ? await response.json() : { error: await response.text() };
    if (!response.ok) throw new Refusal(data.error ?? `the lab answered ${response.status}`, data, response.status);
    return data;
  }
  lab.call = call;

  /** @param {string} path @param {any} [body] */
  lab.post = (path, body = {}) => call("POST", path, JSON.stringify(body), { "content-type": "application/json" });

  /** @param {any} state */
  function know(state) {
    lab.state = state;
    lab.followers.forEach((then) => then(state));
  }

  /** Does something with the session; what it came to. A newer request of the same kind ends this one as `undefined`.
   * @param {string} verb @param {any} [body] @returns {Promise<any>} */
  lab.act = async (verb, body = {}) => {
    await lab.session();
    try {
      const done = await lab.post(`/api/sessions/${lab.id}/do/${verb}`, body);
      know(done.state);
      return done.result ?? null;
    } catch (error) {
      if (error instanceof Refusal && error.data.replaced) return undefined;
      throw error;
    }
  };

  /** Makes sure of a session. @param {boolean} [given] whether it begins with the files of the command line */
  lab.session = async (given = false) => {
    if (lab.id === null) {
      lab.use(String((await lab.post("/api/sessions", { given })).id));
    }
    return lab.id;
  };

  /** Works on another session, or on none. @param {string | null} id */
  lab.use = (id) => {
    lab.id = id;
    lab.state = null;
    lab.source?.close();
    lab.source = null;
    if (id === null) return sessionStorage.removeItem("propwash session");
    sessionStorage.setItem("propwash session", id);
    lab.source = new EventSource(`/api/sessions/${id}/events`);
    lab.source.addEventListener("message", (event) => {
      const news = JSON.parse(event.data);
      lab.listeners.forEach((then) => then(news));
    });
  };

  /** Asks for the state; none where the session is closed. */
  lab.refresh = async () => {
    lab.start = await call("GET", "/api/start");
    if (lab.id === null) return;
    try {
      know(await call("GET", `/api/sessions/${lab.id}`));
      if (!lab.source) lab.use2(lab.id);
    } catch (error) {
      if (!(error instanceof Refusal) || error.status !== 404) throw error;
      lab.use(null);
    }
  };

  /** Listens to a session whose state is known. @param {string} id */
  lab.use2 = (id) => {
    const state = lab.state;
    lab.use(id);
    lab.state = state;
  };

  /** Uploads files one after the other. @param {Iterable<File>} files @param {(words: string) => void} told @returns {Promise<string[]>} what was refused */
  lab.upload = async (files, told) => {
    const refused = [];
    for (const file of files) {
      told(`uploading ${file.name} …`);
      if (file.size > lab.start.most_upload_bytes) {
        refused.push(`${file.name} is larger than ${lab.start.most_upload_bytes >> 20} MB, the most that the lab takes: start \`propwash lab FILE\` with it, or part it`);
        continue;
      }
      try {
        await lab.session();
        const done = await call("PUT", `/api/sessions/${lab.id}/files?name=${encodeURIComponent(file.name)}`, file);
        know(done.state);
      } catch (error) {
        refused.push(/** @type {Error} */ (error).message);
      }
    }
    told("");
    return refused;
  };

  /** Tells something in the line at the bottom. @param {string} words @param {boolean} [bad] */
  lab.tell = (words, bad = false) => {
    const at = /** @type {HTMLElement} */ (document.getElementById("said"));
    at.replaceChildren();
    if (!words) return;
    const close = P.el("button", { type: "button", onclick: () => at.replaceChildren() }, "Close");
    const line = P.el("p", { class: bad ? "said bad" : "said", role: bad ? "alert" : null }, words, " ", close);
    at.append(line);
    // What is done needs no answer.
    if (/: done in /.test(words)) setTimeout(() => line.remove(), 6000);
  };

  /** Runs what a button does; what is refused is told. @param {() => any} work */
  lab.tried = async (work) => {
    try {
      return await work();
    } catch (error) {
      if (error instanceof Refusal && error.data.cancelled) lab.tell("Cancelled. Everything is as it was before.");
      else lab.tell(/** @type {Error} */ (error).message, true);
      return undefined;
    }
  };

  /** A button. @param {string} words @param {() => any} work @param {Record<string, any>} [set] */
  lab.button = (words, work, set = {}) => {
    const button = P.el("button", { type: "button", ...set }, words);
    button.addEventListener("click", async () => {
      if (button.getAttribute("aria-disabled") === "true") return;
      button.setAttribute("aria-disabled", "true");
      lab.tell("");
      await lab.tried(work);
      button.removeAttribute("aria-disabled");
    });
    return button;
  };

  /** A choice with its name. @param {string} title @param {[string, string][]} options value and words @param {string} value @param {(value: string) => any} then */
  lab.choice = (title, options, value, then) => {
    const select = P.el("select", {}, ...options.map(([v, words]) => P.el("option", { value: v, selected: v === value }, words)));
    select.addEventListener("change", () => lab.tried(() => then(select.value)));
    return P.el("label", { class: "choice" }, P.el("span", {}, title), select);
  };

  /** An element of SVG. @param {string} tag @param {Record<string, any>} set @param {...any} inside */
  P.svg = (tag, set = {}, ...inside) => {
    const out = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(set)) out.setAttribute(name, String(value));
    out.append(...inside);
    return out;
  };

  /** Choices of vehicle and scene. */
  lab.vehicleChoice = () => {
    const own = lab.state?.vehicle;
    const options = lab.start.vehicles.map((/** @type {string} */ v) => [v, v]);
    if (own && !own.builtin) options.unshift(["", own.label]);
    if (!own) options.unshift(["", "choose …"]);
    const value = own?.builtin ? own.label : "";
    return lab.choice("Vehicle", options, value, (name) => name && lab.act("vehicle", { name }).then(() => P.show()));
  };
  lab.sceneChoice = () => {
    const own = lab.state?.scene;
    const options = [["", "none"], ...lab.start.scenes.map((/** @type {string} */ s) => [s, s])];
    if (own && !lab.start.scenes.includes(own)) options.push([own, own]);
    return lab.choice("Scene", /** @type {any} */ (options), own ?? "", (name) => (name === own && !lab.start.scenes.includes(name) ? null : lab.act("scene", { name: name || null })));
  };
})();
