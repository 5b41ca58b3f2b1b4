/* SPDX-License-Identifier: Apache-2.0 */
/* Photometric files in small: a whole one per format, and broken ones with what their message must say.  Seeds of the fuzz target too. */
#ifndef TESTS_PHOTOMETRY_CORPUS_H
#define TESTS_PHOTOMETRY_CORPUS_H

#define CORPUS_IES                                                                                                                   \
    "IESNA:LM-63-2002\n[TEST] 12\n[TESTLAB] us\n[ISSUEDATE] 2026\n[MANUFAC] we\n[NEARFIELD] 1 2 3\nTILT=INCLUDE\n1\n2\n0 90\n1 0.9\n"      \
    "1 1000 1 3 3 1 2 0.3 0.2 0\n1 1 20\n0 45 90\n0 45 90\n400 300 20\n400 250 10\n400 200 0\n"

#define CORPUS_LDT                                                                                                                   \
    "Werk\n2\n4\n4\n90\n4\n30\nR 7\nLeuchte\n4711\nl.ldt\n1.1.26 / wir\n1200\n100\n80\n1100\n90\n10\n12\n14\n16\n95,5\n80\n1\n15\n2\n1\nT16\n" \
    "3000\n840\n1B\n39\n-2\nLED\n4000\n830\n2\n30,5\n0.3\n0.4\n0.5\n0.6\n0.7\n0.8\n0.9\n0.95\n0.97\n0.99\n0\n90\n180\n270\n0\n30\n60\n90\n"  \
    "200\n150\n50\n0\n200\n120\n0\n0\n"

#define CORPUS_TM33                                                                                                                  \
    "<?xml version=\"1.0\"?>\n<IESTM33-22><Version>1.1</Version><Header><Manufacturer>we &amp; you</Manufacturer></Header>"              \
    "<Luminaire><Dimensions><Length>600</Length></Dimensions></Luminaire><Emitter><RatedLumens>900</RatedLumens><LuminousData>"         \
    "<PhotometryType>CIE _ C</PhotometryType><Metric>Luminous</Metric><Multiplier>2</Multiplier>"                                        \
    "<IntensityData horz=\"0\" vert=\"0\">50</IntensityData><IntensityData horz=\"0\" vert=\"90\">5</IntensityData>"                     \
    "</LuminousData></Emitter></IESTM33-22>"

#define CORPUS_S001                                                                                                                  \
    "<ATLA_S001_A><Emitter><LuminousData><LuminousIntensity><IntData h=\"0\" v=\"0\">9</IntData><IntData h=\"0\" v=\"90\">1</IntData>"   \
    "<IntData h=\"90\" v=\"90\">3</IntData></LuminousIntensity></LuminousData></Emitter></ATLA_S001_A>"

#define IES_HEAD "IESNA:LM-63-2002\nTILT=NONE\n"
#define LDT_HEAD "w\n1\n1\n1\n0\n2\n90\n\n\n\n\n\n0\n0\n0\n0\n0\n0\n0\n0\n0\n100\n100\n1\n0\n1\n1\nL\n1000\n\n\n5\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n"
#define TM33_DATA(data) "<IESTM33-22><Emitter><LuminousData>" data "</LuminousData></Emitter></IESTM33-22>"

static const struct {
    const char *text, *message;
} corpus_bad[] = {
    {"hello", "is no photometric file"},
    {"\n\n\n\n", "is empty"},
    {"IESNA91\n[TEST] 1\n", "no line TILT="},
    {IES_HEAD, "the file ends where the number of lamps should be"},
    {IES_HEAD "one", "line 3: \"one\" is no number for the number of lamps"},
    {IES_HEAD "1 nan", "\"nan\" is no number for the lumens"},
    {IES_HEAD "1 1.#IND", "\"1.#IND\" is no number"},
    {IES_HEAD "1 1e999", "is no number"},
    {IES_HEAD "1 1 0", "the candela multiplier is 0, outside"},
    {IES_HEAD "1 1 -1", "the candela multiplier is -1, outside"},
    {IES_HEAD "1 1 1 0", "the number of vertical angles is 0, outside [1, 14401]"},
    {IES_HEAD "1 1 1 2.5", "the number of vertical angles is 2.5, not a whole number"},
    {IES_HEAD "1 1 1 2 99999999", "the number of horizontal angles is 1e+08, outside"},
    {IES_HEAD "1 1 1 2 1 4", "the photometric type (1 = C, 2 = B, 3 = A) is 4, outside"},
    {IES_HEAD "1 1 1 2 1 1 3", "the unit of length (1 = feet, 2 = metres) is 3, outside"},
    {IES_HEAD "1 1 1 2 1 1 2 0 0 0 0", "the ballast factor is 0, outside"},
    {IES_HEAD "1 1 1 14401 14401 1 2 0 0 0 1 1 1", "the file is too short for 14401 x 14401 candela values"},
    {IES_HEAD "1 1 1 2 1 1 2 0 0 0 1 1 1 0 90 0 5", "line 3: the file ends where a candela value should be"},
    {IES_HEAD "1 1 1 2 1 1 2 0 0 0 1 1 1\n0 90\n0\n5 -5", "line 6: candela value -5 at horizontal 0, vertical 90 is negative"},
    {IES_HEAD "1 1 1 2 1 1 2 0 0 0 1 1 1 90 0 0 5 5", "vertical angle 2 (0) isn't larger than the one before (90)"},
    {IES_HEAD "1 1 1 2 1 1 2 0 0 0 1 1 1 0 190 0 5 5", "vertical angle 2 is 190, outside [0, 180]"},
    {IES_HEAD "1 1 1 2 2 1 2 0 0 0 1 1 1 0 90 0 60 5 5 5 5", "horizontal angles run from 0 to 60"},
    {IES_HEAD "1 1 1 2 3 1 2 0 0 0 1 1 1 0 90 0 90 45 5 5 5 5 5 5", "horizontal angles run from 0 to 45"},
    {IES_HEAD "1 1 1 2 4 1 2 0 0 0 1 1 1 0 90 0 90 45 180 1 1 1 1 1 1 1 1", "horizontal angle 3 (45) isn't larger"},
    {IES_HEAD "1 1 1 2 3 1 2 0 0 0 1 1 1 0 90 0 90 200 5 5 5 5 5 5", "horizontal angles run from 0 to 200: neither 90, 180 nor the whole circle"},
    {IES_HEAD "1 1 1 2 1 1 2 5000 0 0 1 1 1 0 90 0 5 5", "an extent of 5000 m is outside"},
    {IES_HEAD "1 1 1 1 1 1 2 0 0 0 1 1 1 0 0 5", "one vertical angle alone"},
    {IES_HEAD "1 1 1 3 1 2 2 0 0 0 1 1 1 -90 0 90 0 5 5 5", "one horizontal angle and vertical angles below 0"},
    {"IESNA:LM-63-2002\nTILT=INCLUDE\n4", "the lamp-to-luminaire geometry of TILT is 4, outside [1, 3]"},
    {"IESNA:LM-63-2002\nTILT=INCLUDE\n1 900 1", "the file is too short for 900 tilt angles"},
    {"IESNA:LM-63-2002\nTILT=INCLUDE\n1 2 5 5 1 1 1 1 1", "tilt angle 5 isn't larger"},
    {"w\n1\n", "the file ends after line 2, where the symmetry indicator should be"},
    {"w\n1\n5\n4\n9\n", "line 3: the symmetry indicator is 5, outside [0, 4]"},
    {"w\n1\n1\n1\n1\n1\n", "line 6: the number of gamma angles is 1, outside [2, 14401]"},
    {"w\n1\n1\n1\n0\n2\n90\n\n\n\n\n\nx\n", "line 13: \"x\" is no number for the luminaire's length"},
    {"w\n1\n1\n14000\n0\n2\n90\n\n\n\n\n\n0\n0\n0\n0\n0\n0\n0\n0\n0\n100\n100\n1\n0\n1\n1\nL\n1000\n\n\n5\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n",
     "the file is too short for 14000 C planes"},
    {LDT_HEAD "0\n0\n90\n10\n", "the file ends after line 46, where an intensity should be"},
    {LDT_HEAD "0\n0\n90\n10\n-1\n", "line 47: intensity -1 at C0, gamma 90 is negative"},
    {LDT_HEAD "0\n90\n0\n10\n1\n", "vertical angle 2 (0) isn't larger"},
    {LDT_HEAD "0\n0\n90\n10\nnan\n", "line 47: \"nan\" is no number for an intensity"},
    {"w\n1\n4\n2\n0\n2\n90\n\n\n\n\n\n0\n0\n0\n0\n0\n0\n0\n0\n0\n100\n100\n1\n0\n1\n1\nL\n1000\n\n\n5\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n80\n0\n90\n1\n1\n1\n1\n",
     "symmetry 4 needs planes at C0 and C90"},
    {"w\n1\n0\n1\n0\n2\n90\n\n\n\n\n\n0\n0\n0\n0\n0\n0\n0\n0\n0\n100\n100\n1\n0\n1\n1\nL\n1000\n\n\n5\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n0\n90\n1\n1\n",
     "symmetry 0 wants planes round the whole circle"},
    {"<a", "not well-formed XML"},
    {"<html></html>", "<html> is no TM-33 document"},
    {"<IESTM33-22></IESTM33-22>", "no <Emitter> with <LuminousData>"},
    {TM33_DATA(""), "holds no <IntensityData>"},
    {TM33_DATA("<IntensityData horz=\"0\">1</IntensityData>"), "lacks the attribute vert"},
    {TM33_DATA("<IntensityData horz=\"0\" vert=\"x\">1</IntensityData>"), "attribute vert of <IntensityData> is no number"},
    {TM33_DATA("<IntensityData horz=\"0\" vert=\"0\">NaN</IntensityData>"), "\"NaN\" is no intensity"},
    {TM33_DATA("<IntensityData horz=\"0\" vert=\"0\">-1</IntensityData>"), "intensity -1 is negative"},
    {TM33_DATA("<IntensityData horz=\"0\" vert=\"0\">1</IntensityData><IntensityData horz=\"0\" vert=\"0\">2</IntensityData>"), "a second intensity"},
    {TM33_DATA("<IntensityData horz=\"0\" vert=\"10\">1</IntensityData><IntensityData horz=\"90\" vert=\"20\">2</IntensityData>"),
     "no intensity at horizontal 0, vertical 20"},
    {TM33_DATA("<Multiplier>0</Multiplier><IntensityData horz=\"0\" vert=\"0\">1</IntensityData>"), "<Multiplier> is \"0\""},
    /* A thousand million laughs: entities aren't expanded. */
    {"<!DOCTYPE x [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;&a;&a;&a;&a;\"><!ENTITY c \"&b;&b;&b;&b;&b;&b;&b;&b;\">]>"
     "<IESTM33-22><Emitter><LuminousData><IntensityData horz=\"0\" vert=\"0\">&c;</IntensityData></LuminousData></Emitter></IESTM33-22>",
     "not well-formed XML"},
};

#endif
