// Headless Chromium for tests and pictures of pages: that of $CHROMIUM, else of Debian; WebGL without a graphics card.
"use strict";
const { chromium } = require("playwright-core");

exports.launch = () => chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
