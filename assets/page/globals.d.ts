// Names that the scripts of pages share, for editors and `tsc --checkJs`.
declare var Propwash: any;
declare var THREE: any;
declare var uPlot: any;
